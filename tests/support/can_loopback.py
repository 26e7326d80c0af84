"""In-process channel to the virtual CAN bus: the mock bus of tests, under a fake clock.

With an adapter that `keeps` it acts as a kernel's socket: waiting frames survive `purge` and `close`, and
leave when a node acknowledges again.
"""

from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.byte_transport import output_full
from twind_drivers.clock import Clock
from twind_drivers.ports.channel import CanChannelStatus, CanErrorState
from twind_drivers.ports.frame import ERROR, NOTHING, Frames
from twind_drivers.virtual.can.can_controller import CONTROLLER, OFF, PASSIVE, RESTARTED
from twind_drivers.virtual.can.can_segment import VirtualCanSegment

DEAD = 1.0  # s without a frame taken
LEFT = 0.1  # s after which frames that wait are old ones


class CanLoopback:
    """`CanChannel` without descriptor: `arrival` gives the clock the time of the next possible frame."""

    def __init__(self, line: VirtualCanSegment, clock: Clock) -> None:
        self.name = f"virtual:{line.name}"
        self.warning = ""
        self.condition = CanChannelStatus()
        self._line = line
        self._clock = clock
        self._open = True
        self._stuck_since: float | None = None  # s
        self._deaf = False  # off for frames without acknowledgement, until a frame is received
        line.controller.connect(True)
        line.controller.inbox.clear()

    def fileno(self) -> int:
        """-1: nothing to poll."""
        return -1

    def arrival(self) -> float:
        """Return the earliest time of the next frame, s; an unplugged adapter wakes its reader at once.

        It is that of the line itself: only text is delivered by an adapter in batches.
        """
        return (
            VirtualCanSegment.next_output_time(self._line)
            if self._open and self._line.is_plugged
            else self._clock.now()
        )

    def send(self, frames: Frames, now: float) -> None:
        """See `CanChannel.send`."""
        self._check()
        self._line.advance(now)
        if self._line.controller.backlog():
            self._refuse(len(frames), now)
        self._stuck_since = None
        self.condition.refused += self._line.take_host_frames(frames, now)

    def receive(self, now: float) -> Frames:
        """See `CanChannel.receive`; error frames are counted and set `condition.line`."""
        self._check()
        received = self._line.give_host_frames(now)
        if not received.size:
            return NOTHING
        wrong = (received["id"] & ERROR) != 0
        for frame in received[wrong]:
            self._error(int(frame["id"]), int(frame["data"][1]))
        good: Frames = received[~wrong]
        if good.size and self._deaf:
            self._deaf = False
            self.condition.line = CanErrorState.ACTIVE
        return good

    def drive(self, owner: object) -> None:
        """See `CanChannel.drive`: nothing here."""

    def purge(self) -> None:
        """See `CanChannel.purge`."""
        self._check()
        self._empty()

    def close(self) -> None:
        """See `CanChannel.close`."""
        if self._open and not self._line.controller.adapter.keeps:
            self._line.controller.connect(False)
        self._open = False

    def _empty(self) -> None:
        if not self._line.controller.adapter.keeps:
            self._line.controller.purge()

    def _refuse(self, count: int, now: float) -> None:
        waiting = self._line.controller.backlog()
        since = self._stuck_since = now if self._stuck_since is None else self._stuck_since
        self.condition.refused += count
        if now - since >= LEFT:
            self._deaf = True
            self.condition.line = CanErrorState.OFF
        self._empty()
        if now - since >= DEAD:
            raise PortError(
                self.name, f"has accepted nothing for {now - since:.1f} s", kind=PortErrorCause.LOST
            )
        raise output_full(self.name, waiting, count)

    def _error(self, id: int, detail: int) -> None:
        self.condition.errors += 1
        if id & OFF:
            self.condition.line = CanErrorState.OFF
        elif id & RESTARTED:
            self.condition.line = CanErrorState.ACTIVE
        elif id & CONTROLLER:
            self.condition.line = CanErrorState.PASSIVE if detail & PASSIVE else CanErrorState.ACTIVE

    def _check(self) -> None:
        if not self._open:
            raise PortError(self.name, "the channel is closed", kind=PortErrorCause.LOST)
        if not self._line.is_plugged:
            raise PortError(self.name, "the adapter was unplugged", kind=PortErrorCause.LOST)
