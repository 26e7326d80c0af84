"""Section `types.TYPE` of CAN actuators, and what their joints may say of them. Read once, checked.

Ranges come from the model; what public sources disagree about belongs into the file, and is compared with
what the device tells.
"""

from collections.abc import Callable, Mapping, Sequence
from math import inf, isfinite, isnan

from twind.config.actuator_types import IMPEDANCE, CanType, FrameRanges, Impedance
from twind.config.config_section import ConfigSection
from twind.config.robot_spec import ActuatorSlot
from twind.config.supply_limits import SupplyLimits, ThermalLimits, own_heat, own_supply, usual_heat
from twind_drivers.can.can_models import MODELS, CanActuatorModel
from twind_drivers.can.can_units import COUNT, TURN

# facts of the wire: seven bits; ODrive takes six (its can-protocol page)
MAX_ID = 127
MAX_ODRIVE = 63
MAX_FEEDBACK = 0x7FE  # 11 bits; 7FF carries the register requests of Damiao
FEEDBACK = 0x10  # Damiao: master id beyond the command id, where the file gives none
WATCHDOGS = ("device", "unverified")
TELL_VOLTAGE = ("robstride", "odrive")  # families with a register or message for it
MUTE = ("cubemars", "odrive")  # families whose watchdog cannot be read back over the bus


def can_type(name: str, section: ConfigSection) -> CanType:
    """One kind of CAN actuator. Raises ConfigError."""
    model = MODELS[section.text("device")]
    ranges = _ranges(section.section("ranges"), model)
    spec = CanType(
        name=name,
        device=model.name,
        mode=section.text("mode", IMPEDANCE, (IMPEDANCE,)),
        ticks_per_turn=TURN,
        velocity_lsb_rad_s=COUNT,
        velocity_limit_rad_s=section.number(
            "velocity_limit_rad_s", 2.0, above=0.0, most=ranges.velocity_rad_s
        ),
        acceleration_limit_rad_s2=section.number("acceleration_limit_rad_s2", 10.0, above=0.0, most=1e4),
        registers={},
        supply=_supply(section, model),
        heat=_heat(section, model),
        family=model.family,
        gains=_gains(section.section("gains"), model),
        ranges=ranges,
        torque_limit_nm=section.number("torque_limit_nm", ranges.torque_nm, above=0.0, most=ranges.torque_nm),
        watchdog=_watchdog(section, model),
    )
    section.close()
    return spec


def can_joint(
    source: Callable[[str], ConfigSection], entry: ConfigSection, kind: CanType
) -> tuple[int, str, int | None]:
    """Id, mode and feedback id of a joint that an actuator of `kind` drives. Raises ConfigError."""
    most = MAX_ODRIVE if kind.family == "odrive" else MAX_ID
    id = entry.integer("id", least=0 if kind.family == "odrive" else 1, most=most)
    mode = source("mode").text("mode", kind.mode, (IMPEDANCE,))
    given = entry.has("feedback_id")
    if kind.family != "damiao":
        if given:
            raise entry.refuse("feedback_id", f"a {kind.device} has none: remove it")
        return id, mode, None
    feedback = entry.integer("feedback_id", least=1, most=MAX_FEEDBACK) if given else id + FEEDBACK
    if feedback == id:
        raise entry.refuse("feedback_id", f"{feedback} is its own command id: give it another")
    return id, mode, feedback


def refuse_clash(joint: ActuatorSlot, others: Sequence[ActuatorSlot], entry: ConfigSection) -> None:
    """Raises ConfigError where two of one bus would take, or answer with, the same frames."""
    mine = _frames(joint)
    for other in others:
        if other.bus != joint.bus:
            continue
        theirs = _frames(other)
        for number in sorted(mine.keys() & theirs.keys()):
            key = "feedback_id" if entry.has("feedback_id") and number == joint.feedback_id else "id"
            raise entry.refuse(
                key,
                f"{mine[number]} of {joint.name} and {theirs[number]} of {other.name} are both "
                f"{number:#x} on bus {joint.bus}: give one of them another",
            )


def _frames(joint: ActuatorSlot) -> Mapping[int, str]:
    """Ids of 11 bits that mean this actuator, and what they are to it."""
    kind = joint.type
    if not isinstance(kind, CanType) or kind.family == "robstride":  # its ids have 29 bits
        return {}
    if kind.family == "odrive":
        return {joint.id << 5 | command: f"command {command:#04x}" for command in range(32)}
    ids = {joint.id: "the command id"}
    if joint.feedback_id is not None:
        ids[joint.feedback_id] = "the feedback id"
    return ids


def _ranges(section: ConfigSection, model: CanActuatorModel) -> FrameRanges:
    keys = ("position_rad", "velocity_rad_s", "torque_nm")
    usual = (model.position, model.velocity, model.torque)
    found = []
    for key, own in zip(keys, usual, strict=True):
        if isnan(own) and not section.has(key):
            raise section.refuse(key, f"missing: no source gives that of a {model.name}; say what yours has")
        found.append(section.number(key, own, above=0.0, most=1e4))
    section.close()
    if found[0] > 1e3 or found[0] < TURN / 2 * COUNT:
        raise section.refuse("position_rad", f"{found[0]:g} is not one of half a turn, 3.14, to 1000 rad")
    return FrameRanges(*found)


def _gains(section: ConfigSection, model: CanActuatorModel) -> Impedance:
    stiff, damped = (bound if isfinite(bound) else 1e4 for bound in (model.kp, model.kd))
    gains = Impedance(
        kp=section.number("kp", least=0.0, most=stiff), kd=section.number("kd", least=0.0, most=damped)
    )
    if model.family == "odrive" and gains.kd == 0.0:
        raise section.refuse("kd", "an ODrive's stiffness works through its damping: give more than 0")
    section.close()
    return gains


def _supply(section: ConfigSection, model: CanActuatorModel) -> SupplyLimits:
    """Only where it tells its voltage: what is never read would keep everybody from arming."""
    if section.has("supply") and model.family not in TELL_VOLTAGE:
        raise section.refuse("supply", f"a {model.name} does not tell its voltage: remove it")
    return own_supply(section, SupplyLimits())


def _heat(section: ConfigSection, model: CanActuatorModel) -> ThermalLimits:
    """Below what the vendor advises for the winding; where no source says, the file must."""
    own = inf if model.heat is None else model.heat
    return own_heat(section, usual_heat(own), own)


def _watchdog(section: ConfigSection, model: CanActuatorModel) -> str:
    wanted = section.text("watchdog", "device", WATCHDOGS)
    if wanted == "device" and model.family in MUTE:
        raise section.refuse(
            "watchdog",
            f"a {model.name} cannot show over the bus that its watchdog is armed: set it by the vendor's "
            "tool, then say watchdog: unverified; every arming warns of it",
        )
    return wanted


__all__ = ["can_joint", "can_type", "refuse_clash"]
