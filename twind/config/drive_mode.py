"""The key `mode` of a type or joint: which operating mode its servo has, and what that mode needs. Pure.

`position` is the default: in it alone the servo's own position limits (registers 48, 52) are a second fence.
"""

from collections.abc import Callable, Mapping

from twind.config.robot_spec import OPERATING_MODES, TypeSpec, cap_counts
from twind.config.section import Section
from twind_drivers.dynamixel.modes import check_cap, mode_of
from twind_drivers.dynamixel.tables import number_of, table

CURRENT_BASED = "current_based_position"

# Modes that the driver has, and no robot: what the executor sends are positions.
TOOLS_ONLY: Mapping[str, str] = {
    "velocity": "speeds",
    "current": "currents",
}


def type_mode(section: Section, default: str = "position") -> str:
    """The mode as it is written. Raises ConfigError: no mode, or one that no robot file may name."""
    mode = section.text("mode", default, (*OPERATING_MODES, *TOOLS_ONLY))
    if mode in TOOLS_ONLY:
        known = ", ".join(OPERATING_MODES)
        raise section.refuse(
            "mode",
            f"mode {mode} takes {TOOLS_ONLY[mode]}, and the daemon commands positions: use one of {known}",
        )
    return mode


def joint_mode(source: Callable[[str], Section], entry: Section, kind: TypeSpec) -> str:
    """The mode of a joint: its own, that of the defaults, else its type's. Raises ConfigError.

    Refused: a mode that the servo's model does not have, current-based position without a current.
    """
    mode = type_mode(source("mode"), kind.mode)
    cap = cap_counts(kind)
    if mode == CURRENT_BASED and cap is None:
        raise entry.refuse(
            "mode", f"mode {mode} needs current_limit_a in type {kind.name}: the most current it may use"
        )
    try:
        registers = table(number_of(kind.device))
    except KeyError:
        return mode  # a device that is in no table is named by the budget, with the nearest
    try:
        driven = mode_of(kind.device, registers, OPERATING_MODES[mode])
        check_cap(kind.device, registers, driven, cap if mode == CURRENT_BASED else None)
    except ValueError as error:
        raise entry.refuse("mode", str(error)) from None
    return mode
