"""Writing half of a driver, which exists in mode live only. It is part of the bus contract (`bus`)."""

from typing import Protocol

from twind_drivers.bus import Bools, Ints, Order, Script
from twind_drivers.device_registers import RegisterAddress, RestartResult
from twind_drivers.single_device import SingleDeviceControl


class BusWriter(Protocol):
    """Writing half of a driver."""

    def set_goal_limits(self, lower: Ints, upper: Ints) -> None:
        """Set the range of the goals (m,) (WIRE_CLAMP); drop pending goals. Raises ValueError."""

    def goals(self, ticks: Ints) -> None:
        """Set goals (m,), raw, for the next `request`. Raises WireRangeError; then nothing is pending."""

    def cut(self) -> None:
        """Switch torque off on all devices, ahead of everything else in the next write of any kind.

        Pending goals are dropped, and so are goals given before that write: a goal behind the cut could
        switch torque on again where a device's settings let goals do so.
        """

    def clear(self) -> None:
        """Drop pending goals: after a fault no stale goal may leave. A pending cut stays."""

    def begin(self, order: Order, now: float) -> None:
        """Begin one rare-path transaction that writes; ended by the reader's `answer`."""

    def prepare(self, ticks: Ints, among: Bools | None = None) -> Script[None]:
        """Prepare devices for torque: clear, arm and read back their watchdogs; set gains and output caps.

        `among` (m,): the devices to prepare; None: all. No other device gets a goal until it is prepared.
        `ticks` (m,), the present positions, become the goals in the system call that clears the watchdogs: a
        tripped servo whose torque is still on must not resume its old goal. A device without torque may get
        its goal by `write_goals` alone.
        """

    def write_goals(self, ticks: Ints) -> Script[None]:
        """Write goals (m,), raw, and read them back. Raises DeviceRefused for the first that differs."""

    def read_goals(self) -> Script[Ints]:
        """Read the goals (m,), raw, that the devices hold. Raises NoReply."""

    def torque(self, on: bool) -> Script[None]:
        """Switch torque off in all devices, or on in those that were prepared; read it back.

        Raises DeviceRefused, NoReply.

        Off is written twice: a group write has no reply, so a lost packet would leave torque on.
        """

    def damp(self) -> Script[tuple[int, ...]]:
        """Make the torque soft: cap the output, then lower stiffness and raise damping, read back. RAM only.

        Returns the ids that did not confirm it. A partial result leaves no device stronger than before. The
        caller goes on to torque off in any case. `prepare` restores the strength.
        """

    def begin_single_device(self, id: int, *, cap: int, profile: int) -> SingleDeviceControl:
        """Drive one device alone: `cap` is its largest current, `profile` its speed, raw.

        Until `end_single_device` the other devices receive only torque off. Raises ValueError for a device
        that cannot be driven in this way.
        """

    def end_single_device(self) -> None:
        """Command all devices again, as before `begin_single_device`."""

    def write(self, id: int, name: str, value: int) -> Script[RegisterAddress]:
        """Write one register, read it back. Raises NoReply, DeviceRefused, KeyError, ValueError (range)."""

    def reboot(self, id: int, *, shut_down: bool = False) -> Script[RestartResult]:
        """Restart one device, wait for its reply, restore its settings. Its torque stays off.

        Raises DeviceRefused while its torque is on, unless it is `shut_down` by its hardware error.
        """
