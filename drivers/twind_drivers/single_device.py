"""Protocol for one device of a bus driven alone with little current, to find an endstop.

It is part of the bus contract (`bus`).
"""

from typing import Any, Protocol

from twind_drivers.bus import Script
from twind_drivers.device_registers import RestartResult


class SingleDeviceControl(Protocol):
    """One device of a bus that has torque while the others have none.

    Counts are those that the device reports in the current-limited mode. They may differ from earlier ones
    by whole turns. Order of calls: `look`, `enter_current_mode`, `set_goal_limits`, `prepare`, `energise`,
    `goal` in each tick; torque off by the writer; `give_back`. Torque before the cap would drive the joint
    against its endstop with full force. All scripts raise DeviceRefused and NoReply.
    """

    id: int
    watchdog: int  # raw value of its watchdog register while it has torque

    def set_goal_limits(self, lower: int, upper: int) -> None:
        """Set the range of goals that may be sent; none before the first call (WIRE_CLAMP).

        Raises ValueError.
        """

    def goal(self, tick: int) -> None:
        """Set the goal (raw count) of the next `request`. Raises WireRangeError; then nothing is pending."""

    def look(self) -> Script[Any]:
        """Read the settings that `give_back` restores. Refused with torque on or a hardware error."""

    def describe_leftovers(self, kept: Any) -> str:
        """Return a text of the settings that remain changed if `give_back` does not run."""

    def enter_current_mode(self, kept: Any) -> Script[None]:
        """Switch to the mode in which a current cap acts, and read it back."""

    def prepare(self, kept: Any, tick: int) -> Script[None]:
        """Write cap, gains, slow profile, goal `tick` and watchdog before torque, and read them back."""

    def energise(self) -> Script[None]:
        """Switch torque on and read it back; refused in any other mode."""

    def give_back(self, kept: Any) -> Script[RestartResult]:
        """Switch torque off, restore all settings and read them back. DeviceRefused names the difference."""
