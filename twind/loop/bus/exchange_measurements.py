"""Measurements of one exchange with all buses: traffic, and times of the replies. Loop's process."""

from collections.abc import Sequence
from math import inf, nan

from twind.loop.bus.bus_port import BusPort, PortState
from twind.loop.bus.imu_poller import ImuPoller
from twind.robot.arrays import every, some
from twind.safety.guard_types import BusTraffic
from twind_drivers.bus import BusSample


class ExchangeMeasurements:
    """Counts and times of one exchange, in the order of the buses."""

    def __init__(self, buses: int) -> None:
        self.discarded = 0  # bytes thrown away (RX_SHAPE)
        self.traffic = tuple(BusTraffic() for _ in range(buses))
        # s, request to first look at the reply, then to its last byte; NaN: no device replied
        self.hops = (nan, nan)
        self.trips = [nan] * buses  # s, request to last byte of each bus; NaN: no device on it replied
        self.skew = nan  # s, between the replies of the first and the last bus; NaN: fewer than two replied
        self.worst_skew = nan  # s, of the run
        # s, when the first and the last bus had replied
        self._earliest = inf
        self._latest = -inf
        self._answered = 0  # buses with a reply

    def begin(self, ports: Sequence[BusPort]) -> None:
        """Forget the exchange before; the worst skew stays."""
        self.discarded = 0
        self._earliest = inf
        self._latest = -inf
        self._answered = 0
        some_hold = False
        for port in ports:
            some_hold = some_hold or port.holding
        for number, port in enumerate(ports):
            self.traffic[number].reset(left_out=some_hold and not port.holding)
            self.trips[number] = nan

    def take(self, number: int, port: BusPort, sample: BusSample, inertial: ImuPoller | None) -> None:
        """Take the reading of one bus, and count it for BUS_ERRORS unless an IMU spoilt it.

        Only identified devices count. `identity` reports missing devices.
        """
        traffic = self.traffic[number]
        whole = every(sample.heard)
        traffic.answered = whole or some(sample.heard)
        traffic.foreign = sample.foreign
        traffic.line = sample.line
        if inertial is None or inertial.bus != number or not inertial.listen(sample):
            traffic.asked = port.holding or port.link is PortState.CONNECTED
            traffic.bad = sample.discarded > 0 or (not whole and some(sample.asked & ~sample.heard))
            self.discarded += sample.discarded
            port.counts.errors += not whole
        if traffic.answered:
            self.trips[number] = sample.received - sample.sent
            self._answered += 1
            self._latest = max(self._latest, sample.received)
            self._earliest = min(self._earliest, sample.received)

    def end(self, sent: float, first: float, *, fresh: bool) -> float:
        """Return when the last bus had replied to the requests of `sent`; `first`: the first bytes. All s.

        `fresh`: a joint has a new reading.
        """
        received = max(sent, self._latest)
        self.hops = (first - sent, received - first) if fresh else (nan, nan)
        self.skew = self._latest - self._earliest if self._answered > 1 else nan
        if self._answered > 1 and not self.skew <= self.worst_skew:
            self.worst_skew = self.skew
        return received
