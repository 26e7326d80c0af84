"""Virtual CAN bus: its nodes behind an adapter that gives frames, and slcan text around them.

A server of bytes (a pseudo-terminal, `serial_loopback`) uses it like the bus of serial servos.
"""

from math import ceil, inf, isfinite

from twind_drivers.virtual.can.can_segment import VirtualCanSegment
from twind_drivers.virtual.virtual_sensor import VirtualSensor


class VirtualCanBus(VirtualCanSegment):
    """A `VirtualCanSegment` that speaks slcan text too. Its channel is closed until it is opened."""

    kind = "can"
    sensor: VirtualSensor | None = None
    _held = b""  # the host has sent it while the adapter is stalled
    _text_answers = b""  # answers of the adapter to the host's lines
    _answered_at = -inf  # s, time of the first of those

    @property
    def backlog(self) -> int:
        """Bytes that a stalled adapter leaves with the host."""
        return len(self._held)

    def flush(self) -> None:
        """Discard frames that have not been sent."""
        self._held = b""

    def receive(self, data: bytes, now: float) -> None:
        """Text of the host, sent at `now`."""
        if not self.is_plugged:
            self.flush()
            return
        self._run(now)
        data = self._held + data
        self._held = b""
        if self.faults.stalled:
            self._held = data
        else:
            self._answered_at = self._answered_at if self._text_answers else now
            self._text_answers += self.text.receive_text(data, now)

    def next_output_time(self) -> float:
        """Return the next output time, s; text leaves with the adapter's next batch."""
        if self._held and not self.faults.stalled:
            return -inf
        controller = self.controller
        batch = controller.adapter.batch
        if not batch:
            return -inf if self._text_answers else super().next_output_time()
        first = controller.since if controller.inbox else super().next_output_time()
        if self._text_answers:
            first = min(first, self._answered_at)
        return ceil(first / batch - 1e-6) * batch if isfinite(first) else first

    def take(self, now: float) -> bytes:
        """Text that has arrived at the host by `now`."""
        if not self.is_plugged:
            self._text_answers = b""
            return b""
        if self._held:
            self.receive(b"", now)
        if self.controller.adapter.batch:
            self._run(now)
            if self.next_output_time() > now:
                return b""
        heard = self._arrived(now)
        said = self._text_answers
        self._text_answers = b""
        return said + self.text.print(heard)

    def line(self, baud: int) -> None:
        """The host's port is set to `baud`: a USB adapter does not care."""

    def motor_stand_ins(self) -> dict[str, str]:
        """Return nothing: the robot file gives the torque of each actuator."""
        return {}

    def skip_time(self, seconds: float) -> None:
        """Nodes have no clock register that goes on while time stands still."""
