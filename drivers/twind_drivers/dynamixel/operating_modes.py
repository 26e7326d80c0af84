"""Operating modes: goal register, unit and bounds of each. Pure.

Modes may differ between the devices of one bus; each goal has the unit of its mode. The mode is EEPROM
(register 11). No code here changes it: that needs torque off and drops the joint.

| mode | goal | unit | bound of the servo | bound of twind (WIRE_CLAMP) | before torque |
|---|---|---|---|---|---|
| 0 current | 102, 2 bytes | count | +-current limit (38) | lower..upper within +-(38) | goal 0 |
| 1 velocity | 104, 4 bytes | 0.229 rpm | +-velocity limit (44) | lower..upper within +-(44) | goal 0 |
| 3 position | 116, 4 bytes | tick | position limits (52, 48) | lower..upper | goal = present, 100 := (36) |
| 4 extended position | 116, 4 bytes | tick | +-1,048,575 alone | lower..upper alone | as in mode 3 |
| 5 current-based | 116, 4 bytes | tick | as in mode 4 | as in mode 4 | cap in 102, 100 = its limit (36) |

Profile acceleration (108) acts in all of them but mode 0, profile velocity (112) in 3, 4 and 5 only. Mode 16
(PWM) is not driven: no register bounds its speed or current. Source: e-manual, control table pages of the X
series, "Operating Mode (11)", "Goal Current (102)", "Goal Velocity (104)", "Goal Position (116)", "Min/Max
Position Limit (48, 52)", "Profile Acceleration (108)". Addresses are those of the X series.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from twind_drivers.dynamixel.control_tables import ControlTable
from twind_drivers.dynamixel.device_layout import RegisterBlock

GOALS = ("goal_current", "goal_velocity", "goal_position")


@dataclass(frozen=True, slots=True)
class OperatingMode:
    """Operating mode with its goal register and limit register."""

    number: int  # of register 11
    name: str
    goal: str  # goal register
    limit: str | None  # the register that bounds the goal's magnitude; None: not one register

    @property
    def rests_at_zero(self) -> bool:
        """Return True if goals are speeds or currents, with 0 at rest; False for positions."""
        return self.goal != "goal_position"


MODES: Mapping[int, OperatingMode] = {
    mode.number: mode
    for mode in (
        OperatingMode(0, "current", "goal_current", "current_limit"),
        OperatingMode(1, "velocity", "goal_velocity", "velocity_limit"),
        OperatingMode(3, "position", "goal_position", None),
        OperatingMode(4, "extended position", "goal_position", None),
        OperatingMode(5, "current-based position", "goal_position", None),
    )
}
VELOCITY = 1
POSITION = 3
CURRENT_BASED = 5


def mode_of(where: str, table: ControlTable, number: int) -> OperatingMode:
    """Return the mode of that number. `where`: start of the error message.

    Raises ValueError if the model lacks the mode or it is not driven here.
    """
    if table.facts.undriven:
        raise ValueError(f"{where}: {table.model} is not driven here: {table.facts.undriven}")
    if number not in MODES:
        known = ", ".join(f"{each.number} {each.name}" for each in MODES.values())
        raise ValueError(f"{where}: operating mode {number} is not driven here; known are {known}")
    mode = MODES[number]
    needed = (mode.goal, *filter(None, (mode.limit,)))
    if number == CURRENT_BASED:
        needed += ("goal_current", "current_limit", "goal_pwm", "pwm_limit")
    for register in needed:
        if register not in table:
            raise ValueError(f"{where}: {table.model} has no {register}: mode {number} is not possible")
    if number not in table.facts.modes:
        raise ValueError(f"{where}: {table.model} has no mode {number}; it has {sorted(table.facts.modes)}")
    return mode


def check_bounds(where: str, table: ControlTable, mode: OperatingMode, lower: int, upper: int) -> None:
    """Raise ValueError for bounds that this mode cannot have.

    Bounds of speeds and currents must contain 0, so that a device can rest. Outside mode 3 bounds must be
    inside the range of the goal register. In mode 3 the servo's own limits hold as well.
    """
    if mode.rests_at_zero and not lower <= 0 <= upper:
        raise ValueError(f"{where}: bounds {lower}..{upper} of mode {mode.number} must hold 0, to rest")
    least, most = table[mode.goal].bounds
    if mode.number != POSITION and not (least <= lower and upper <= most):
        raise ValueError(
            f"{where}: bounds {lower}..{upper} of mode {mode.number} leave {least}..{most}, "
            f"the range of {mode.goal} of {table.model}"
        )


def check_cap(where: str, table: ControlTable, mode: OperatingMode, cap: int | None) -> None:
    """Raise ValueError for mode 5 without a cap in 1..largest goal current, or a cap in another mode."""
    if mode.number != CURRENT_BASED:
        if cap is not None:
            raise ValueError(f"{where}: a current cap belongs to mode 5, not to mode {mode.number}")
        return
    most = table["goal_current"].bounds[1]
    if cap is None or not 1 <= cap <= most:
        raise ValueError(f"{where}: mode 5 needs a current cap of 1..{most} counts, got {cap}")


def block(table: ControlTable, *names: str) -> RegisterBlock:
    """Return the block from the first of `names` to the end of the last. Raises InvalidInput."""
    first = table[names[0]]
    last = table[names[-1]]
    return RegisterBlock(first.address, last.end - first.address)


def fences(
    table: ControlTable, mode: OperatingMode, lower: int, upper: int, cap: int | None
) -> dict[RegisterBlock, tuple[int, int]]:
    """Return the range of words permitted in each goal register; an empty range (0..-1) permits none.

    Only the goal of the device's mode is written. Goal current is a cap in mode 5 and has no effect in modes
    1, 3 and 4.
    """
    found: dict[RegisterBlock, tuple[int, int]] = {}
    for name in GOALS:
        if name not in table:
            continue
        if name == mode.goal:
            found[block(table, name)] = (lower, upper)
        elif name == "goal_current":
            found[block(table, name)] = (0, table[name].bounds[1] if cap is None else cap)
        else:
            found[block(table, name)] = (0, -1)
    return found
