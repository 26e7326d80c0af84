"""One device of a bus driven by itself, weakly, to find a stop: part of the contract in `bus`."""

from typing import Any, Protocol

from twind_drivers.bus import RestartResult, Script


class SingleDeviceControl(Protocol):
    """One device of a bus; nobody else there has torque.

    Counts are the device's own, as it tells them once it was entered: perhaps whole turns off those before.
    In this order: `look`, `enter`, `bound`, `prepare`, `energise`, `goal` each tick; torque off by the
    writer; `give_back`. All scripts raise DeviceRefused and NoReply.
    """

    id: int
    watchdog: int  # what its watchdog reads while it has torque

    def set_goal_limits(self, lower: int, upper: int) -> None:
        """Goals that may be sent from now on; none before (WIRE_CLAMP). Raises ValueError."""

    def goal(self, tick: int) -> None:
        """Goal for the next `request`. Raises WireClamp; then nothing is pending."""

    def look(self) -> Script[Any]:
        """What it is set to, to be given back. Refused while its torque is on, or with a hardware error."""

    def describe_leftovers(self, kept: Any) -> str:
        """What it is left with where it is not given back, in words."""

    def enter_current_mode(self, kept: Any) -> Script[None]:
        """Into the mode in which it obeys a current cap, read back."""

    def prepare(self, kept: Any, tick: int) -> Script[None]:
        """Cap, gains, slow profile, goal := `tick`, its watchdog: before torque, read back."""

    def energise(self) -> Script[None]:
        """Torque on, read back; none where it is not in that mode any more."""

    def give_back(self, kept: Any) -> Script[RestartResult]:
        """Torque off, everything as it was, read back. DeviceRefused names what differs."""
