"""The key `mode` of a type or joint: which operating mode its servo has, and what that mode needs. Pure.

`position` is the default: in it alone the servo's own position limits (registers 48, 52) are a second fence.
"""

from collections.abc import Callable, Mapping

from twind.config.actuator_types import OPERATING_MODES, ServoType
from twind.config.config_section import ConfigSection
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.operating_modes import mode_of

CURRENT_BASED = "current_based_position"

# Modes that the driver has, and no robot: what the executor sends are positions.
TOOLS_ONLY: Mapping[str, str] = {
    "velocity": "speeds",
    "current": "currents",
}


def type_mode(section: ConfigSection, default: str = "position") -> str:
    """The mode as it is written. Raises ConfigError: no mode, or one that no robot file may name."""
    given = section.plain("mode")
    if isinstance(given, int | float):  # what register 11 holds, not what a person can check
        meant = [name for name, number in OPERATING_MODES.items() if number == given and given is not True]
        names = meant or list(OPERATING_MODES)
        raise section.refuse("mode", f"{given} is a number; a mode is named: write {' or '.join(names)}")
    mode = section.text("mode", default, (*OPERATING_MODES, *TOOLS_ONLY))
    if mode in TOOLS_ONLY:
        known = ", ".join(OPERATING_MODES)
        raise section.refuse(
            "mode",
            f"mode {mode} takes {TOOLS_ONLY[mode]}, and the daemon commands positions: use one of {known}",
        )
    return mode


def joint_mode(
    source: Callable[[str], ConfigSection], entry: ConfigSection, kind: ServoType, described: ConfigSection
) -> str:
    """The mode of a joint: its own, that of the defaults, else its type's. Raises ConfigError.

    Refused: a mode that the servo's model does not have, current-based position without a current that it
    takes. `described`: the section of `kind`.
    """
    mode = type_mode(source("mode"), kind.mode)
    cap = kind.cap_counts
    if mode == CURRENT_BASED and cap is None:
        raise entry.refuse(
            "mode", f"mode {mode} needs current_limit_a in type {kind.name}: the most current it may use"
        )
    registers = table(number_of(kind.device))
    try:
        mode_of(f"type {kind.name}", registers, OPERATING_MODES[mode])
    except ValueError as error:
        raise entry.refuse("mode", str(error)) from None
    if mode == CURRENT_BASED:
        _require_current(kind, described, registers["goal_current"].bounds[1])
    return mode


def _require_current(kind: ServoType, described: ConfigSection, counts: int) -> None:
    """Raises ConfigError where `current_limit_a` is no goal current of 1..`counts`, told in ampere."""
    cap = kind.cap_counts
    most = counts * kind.current_lsb_a
    if cap is None or not 1 <= cap <= counts:
        raise described.refuse(
            "current_limit_a",
            f"{kind.current_limit_a:g} A is outside {kind.current_lsb_a:.4g}..{most:.4g} A, what a "
            f"{kind.device} takes as goal current (102) in mode {CURRENT_BASED}",
        )
