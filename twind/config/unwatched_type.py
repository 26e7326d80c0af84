"""Types of devices without a watchdog: what their robot file must say, and what bounds their goals.

Such a device holds its last goal when the daemon dies.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta

from twind.config.actuator_types import ExpectedDevice, TypeSpec
from twind.config.family_keys import TypeKeys
from twind_drivers.bus import IdentifiedDevice

MICROSECONDS = 2  # of one count of a return delay


class UnwatchedTypeKeys(TypeKeys, kw_only=True):
    """Keys of a type without a watchdog."""

    watchdog: Literal["", "none"] = ""
    """`none` | required to arm | Feetech: states that a servo holds its last goal when the daemon dies"""
    lead_limit_rad: Annotated[float, Meta(ge=0.02, le=0.2)] = 0.15
    """0.02–0.2 | 0.15 | without a watchdog: how far a goal may lead its joint beyond the sag of its load; see
    [no watchdog](safety.md#no-watchdog)"""


@dataclass(frozen=True, slots=True)
class UnwatchedType(TypeSpec):
    """Type of devices without a watchdog. `unfit` of a family yields from `unaccepted`."""

    watchdog: str  # `none`; empty: the file does not say it
    lead_limit: float  # rad, at the joint

    @property
    def watched(self) -> bool:
        """False: it holds its last goal when its master dies."""
        return False

    @property
    def lead_limit_rad(self) -> float:
        """The value of the robot file."""
        return self.lead_limit

    def unaccepted(self) -> Iterator[str]:
        """Yield what is missing where the robot file does not say `watchdog: none`."""
        if self.watchdog != "none":
            yield (
                "has no watchdog: it holds its last goal when the daemon dies. Write `watchdog: none` to "
                f"type {self.name} of the robot file if that is acceptable"
            )

    def other_model(self, device: IdentifiedDevice) -> str:
        """Return the refusal of a device of another model."""
        found = device.model_name or "a model that is in no table"
        return f"is {found} (model number {device.model_number}), the robot file says {self.device}"

    def other_settings(self, joint: ExpectedDevice, device: IdentifiedDevice, delay: int) -> Iterator[str]:
        """Yield a return delay above `delay` (µs), and registers that differ from the robot file."""
        own = MICROSECONDS * device.settings.get("return_delay_time", 0)
        if own > delay:
            yield (
                f"waits {own} us before each reply, the robot file says {delay}: `twindctl "
                f"register write {joint.bus} {joint.id} return_delay_time {delay // MICROSECONDS}`"
            )
        yield from self.other_registers(joint, device)

    def other_registers(self, joint: ExpectedDevice, device: IdentifiedDevice) -> Iterator[str]:
        """Yield registers that differ from the robot file."""
        for register, wanted in joint.registers.items():
            value = device.settings.get(register)
            if value != wanted:
                yield f"{register} is {value}, the robot file says {wanted}"
