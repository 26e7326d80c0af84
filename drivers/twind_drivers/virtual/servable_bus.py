"""Interface of a virtual bus to its servers (a pseudo-terminal, the loopback), for any kind of device."""

from collections.abc import Mapping
from typing import Any, Protocol

from twind_drivers.virtual.shown_position_log import ShownPositionLog
from twind_drivers.virtual.virtual_sensor import VirtualSensor


class ServableBus(Protocol):
    """Bytes in, bytes out, as time passes (s, never back); and the true state of its devices."""

    name: str
    kind: str  # as the robot file has it: its driver family
    faults: Any  # its orders, by name; `stalled`: it takes nothing from the host

    @property
    def sensor(self) -> VirtualSensor | None:
        """Inertial sensor of the robot, on this bus; None: another bus has it, or none."""

    @property
    def is_plugged(self) -> bool:
        """True if the adapter is plugged in."""

    @property
    def backlog(self) -> int:
        """Bytes that a stalled adapter has taken and not sent."""

    @property
    def history(self) -> ShownPositionLog | None:
        """Values kept by `record`, in the order of `ids`; None: nothing."""

    def flush(self) -> None:
        """Drop the bytes of the backlog: they are never sent."""

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host, sent at `now`."""

    def next_output_time(self) -> float:
        """Return the time (s) before which nothing comes; `inf`: nothing is under way."""

    def take(self, now: float) -> bytes:
        """Return the bytes that have arrived at the host by `now`."""

    def advance(self, now: float) -> None:
        """Let time pass without traffic."""

    def line(self, baud: int) -> None:
        """Set the host's port to `baud`."""

    def ids(self) -> list[int]:
        """Return the ids of the devices, in the order of rows."""

    def truth(self, now: float) -> list[dict[str, object]]:
        """Return the true state of each device at `now`, independent of the bus."""

    def motor_stand_ins(self) -> Mapping[str, str]:
        """Return, for each model here without motor figures, the model that lends its own."""

    def skip_time(self, seconds: float) -> None:
        """Skip time in which the devices do not run; those of their clocks that go on count it."""
