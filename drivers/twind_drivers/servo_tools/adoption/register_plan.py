"""Required register values of a new servo, and the order of their writes. Pure.

The daemon compares registers and never writes them: here they are made what it asks.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from twind.command_line.verb import Rejected
from twind.config.robot_spec import JointSpec
from twind_drivers.servo_tools.family_tools import FamilyTools
from twind_drivers.servo_tools.scan_protocol import ServoTable
from twind_drivers.servo_tools.servo_configurator import LOCK

FIRST = ("status_return_level", "operating_mode", "drive_mode")  # a change of mode resets other registers


@dataclass(frozen=True, slots=True)
class RegisterStep:
    """One register that holds `now` and is to hold `then`."""

    register: str
    address: int
    now: int
    then: int

    def __str__(self) -> str:
        return f"{self.register} ({self.address}): {self.now} -> {self.then}"


def wanted(
    joint: JointSpec, tools: FamilyTools, table: ServoTable, now: Mapping[str, int], *, new: bool
) -> dict[str, int]:
    """Return the required values by register.

    `new`: False for a servo at its place, whose limits and offset may be a calibration: they stay, unless its
    family tells no demanded registers apart.
    """
    if new or tools.demanded is None:
        return tools.required(joint, table, now)
    return tools.demanded(joint, table, now) | ({LOCK: 1} if tools.locks else {})


def plan(
    joint: JointSpec,
    tools: FamilyTools,
    table: ServoTable,
    firmware: int,
    now: Mapping[str, int],
    *,
    new: bool,
) -> tuple[RegisterStep, ...]:
    """The registers that differ, in the order to write them; `now`: what they hold; `new` as in `wanted`.

    Raises Rejected before anything is written: a value that the servo does not take, and a servo that the
    daemon would still not accept afterwards, with the reasons.
    """
    if why := tools.objection(now):
        raise Rejected(f"{joint.name}: {why}")
    target = wanted(joint, tools, table, now, new=new)
    after = tools.identified(joint.id, joint.type.device, firmware, {**now, **target})
    if wrong := list(joint.type.unfit(joint, after)):
        raise Rejected(f"{joint.name}: adopted, the daemon would refuse it all the same: {'; '.join(wrong)}")
    differing = [key for key, value in target.items() if now.get(key) != value]
    for key in differing:
        try:
            table[key].check(target[key])
        except ValueError as error:
            raise Rejected(f"{joint.name}: {error}; correct the robot file") from None
    order = sorted(differing, key=lambda key: FIRST.index(key) if key in FIRST else len(FIRST))
    return tuple(RegisterStep(key, table[key].address, now[key], target[key]) for key in order if key in now)


def different(
    joint: JointSpec,
    tools: FamilyTools,
    table: ServoTable,
    firmware: int,
    now: Mapping[str, int],
    *,
    new: bool,
) -> Iterator[str]:
    """Yield the differences of a servo's registers from the required values, as text; none: it is adopted."""
    yield from joint.type.unfit(joint, tools.identified(joint.id, joint.type.device, firmware, now))
    for key, value in wanted(joint, tools, table, now, new=new).items():
        if now.get(key) != value:
            yield f"{key} ({table[key].address}) is {now.get(key)}, not {value}"
