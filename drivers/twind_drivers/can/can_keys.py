"""Keys of CAN actuators in a robot file: their buses, types, and slots of joints. Read once, checked.

Ranges come from the model; what public sources disagree about belongs into the file, and is compared with
what the device tells.
"""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from math import inf, isfinite, isnan
from typing import Annotated, Literal

from msgspec import Meta

from twind.config.actuator_types import TypeSpec
from twind.config.config_reader import ConfigReader, ConfigStruct
from twind.config.driver_family import SlotEntry
from twind.config.family_keys import BusKeys, SlotKeys, TypeKeys
from twind.config.robot_spec import ActuatorSlot, BusSpec
from twind.config.supply_limits import SupplyLimits, heat, supply, usual_heat
from twind_drivers.can.can_models import MODELS, CanActuatorModel
from twind_drivers.can.can_type import IMPEDANCE, KIND, CanType, FrameRanges, Impedance
from twind_drivers.can.can_units import COUNT, TURN

# facts of the wire: seven bits; ODrive takes six (its can-protocol page)
MAX_ID = 127
MAX_ODRIVE = 63
MAX_FEEDBACK = 0x7FE  # 11 bits; 7FF carries the register requests of Damiao
FEEDBACK = 0x10  # Damiao: master id beyond the command id, where the file gives none
TELL_VOLTAGE = ("robstride", "odrive")  # families with a register or message for it
MUTE = ("cubemars", "odrive")  # families whose watchdog cannot be read back over the bus

Range = Annotated[float, Meta(gt=0.0, le=1e4)]


class CanBusKeys(BusKeys):
    """Entry of a CAN bus. The bit rates are those that slcan has a command for (S4 to S8)."""

    bitrate: Literal[125_000, 250_000, 500_000, 800_000, 1_000_000] = 1_000_000
    """CAN: bit/s"""


class RangeKeys(ConfigStruct):
    """Section `ranges` of a CAN type: what the fields of its frames span, both ways."""

    position_rad: Range | None = None
    """3.14–1000 | the model's | CAN: range of the field, both ways. A wrong range gives wrong positions"""
    velocity_rad_s: Range | None = None
    """>0 | the model's | CAN: ranges of those fields"""
    torque_nm: Range | None = None
    """>0 | the model's | CAN: ranges of those fields"""


class CanSlotKeys(SlotKeys, kw_only=True):
    """Keys of what turns by a CAN actuator."""

    id: int  # bounds depend on the family
    """0–252; CAN: 1–127, ODrive: 0–63 | | on its bus"""
    mode: Literal["impedance"] = IMPEDANCE
    """as of a type | of `defaults`, else its type's |"""
    feedback_id: Annotated[int, Meta(ge=1, le=MAX_FEEDBACK)] | None = None
    """| `id` + 16 | Damiao: master id (register 7). All ids of a bus differ"""


class CanTypeKeys(TypeKeys, kw_only=True):
    """Entry of `types` for CAN actuators."""

    mode: Literal["impedance"] = IMPEDANCE
    """`position`, `extended_position`, `current_based_position`; CAN: `impedance` | `position`; CAN:
    `impedance` | operating mode, register 11: 3, 4 or 5. Only `position` applies the servo's own limits"""
    ranges: RangeKeys
    gains: Impedance
    velocity_limit_rad_s: Annotated[float, Meta(gt=0.0)] = 2.0
    """>0, ≤100 | | of the motor shaft"""
    torque_limit_nm: Annotated[float, Meta(gt=0.0)] | None = None
    """>0, ≤ `ranges.torque_nm` | `ranges.torque_nm` | CAN: a path that needs more is reported. Only RobStride
    enforces it"""
    watchdog: Literal["device", "unverified", "none"] = "device"
    """CAN: `device`, `unverified`; without one: `none` | CAN: `device` | CAN: `device` is read back before
    torque, `unverified` cannot be, see [CAN buses](#can-buses). without one: `none` is required to arm, see
    [no watchdog](safety.md#no-watchdog)"""


def can_bus(name: str, section: ConfigReader) -> BusSpec:
    """One CAN bus. Raises ConfigError."""
    given = section.read(CanBusKeys)
    return BusSpec(name, KIND, given.port, given.bitrate, latency_timer_ms=0)


def can_slot(entry: SlotEntry, kind: TypeSpec) -> ActuatorSlot:
    """The CAN actuator of a joint, or beside the joints. Raises ConfigError."""
    assert isinstance(kind, CanType)
    given = entry.section.read(CanSlotKeys, *entry.beside)
    feedback = require_can_ids(entry.section, given, kind)
    return ActuatorSlot(
        entry.name, entry.bus, given.id, kind, given.sign, given.ratio, {}, given.mode, feedback
    )


def can_type(name: str, section: ConfigReader) -> CanType:
    """One kind of CAN actuator. Raises ConfigError."""
    given = section.read(CanTypeKeys)
    model = MODELS.get(given.device)
    if model is None:
        near = get_close_matches(given.device.upper(), MODELS, 1)
        hint = f"; nearest: {near[0]}" if near else f"; known are {', '.join(MODELS)}"
        raise section.refuse("device", f"no CAN actuator {given.device!r}{hint}")
    ranges = _ranges(section.section("ranges"), given.ranges, model)
    section.check("velocity_limit_rad_s", Annotated[float, Meta(gt=0.0, le=ranges.velocity_rad_s)])
    section.check("torque_limit_nm", Annotated[float, Meta(gt=0.0, le=ranges.torque_nm)])
    _require_gains(section.section("gains"), given.gains, model)
    _require_provable(section, given.watchdog, model)
    hottest = inf if model.heat is None else model.heat
    return CanType(
        name=name,
        device=model.name,
        mode=given.mode,
        ticks_per_turn=TURN,
        velocity_lsb_rad_s=COUNT,
        velocity_limit_rad_s=given.velocity_limit_rad_s,
        acceleration_limit_rad_s2=given.acceleration_limit_rad_s2,
        registers={},
        supply=supply(section.section("supply"), given.supply, SupplyLimits()),
        heat=heat(section.section("heat"), given.heat, usual_heat(hottest), hottest),
        family=model.family,
        gains=given.gains,
        ranges=ranges,
        torque_limit_nm=given.torque_limit_nm or ranges.torque_nm,
        watchdog=given.watchdog,
    )


def require_can_ids(entry: ConfigReader, given: CanSlotKeys, kind: CanType) -> int | None:
    """The feedback id of an actuator of `kind`. Raises ConfigError for ids that it cannot have."""
    least, most = (0, MAX_ODRIVE) if kind.family == "odrive" else (1, MAX_ID)
    entry.check("id", Annotated[int, Meta(ge=least, le=most)])
    if kind.family != "damiao":
        if given.feedback_id is not None:
            raise entry.refuse("feedback_id", f"a {kind.device} has none: remove it")
        return None
    feedback = given.id + FEEDBACK if given.feedback_id is None else given.feedback_id
    if feedback == given.id:
        raise entry.refuse("feedback_id", f"{feedback} is its own command id: give it another")
    return feedback


def refuse_clash(joint: ActuatorSlot, others: Sequence[ActuatorSlot], entry: ConfigReader) -> None:
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


def _ranges(section: ConfigReader, given: RangeKeys, model: CanActuatorModel) -> FrameRanges:
    usual = {"position_rad": model.position, "velocity_rad_s": model.velocity, "torque_nm": model.torque}
    found = {key: getattr(given, key) or own for key, own in usual.items()}
    for key, span in found.items():
        if isnan(span):
            raise section.refuse(key, f"missing: no source gives that of a {model.name}; say what yours has")
    ranges = FrameRanges(**found)
    if not TURN / 2 * COUNT <= ranges.position_rad <= 1e3:
        message = f"{ranges.position_rad:g} is not one of half a turn, 3.14, to 1000 rad"
        raise section.refuse("position_rad", message)
    return ranges


def _require_gains(section: ConfigReader, gains: Impedance, model: CanActuatorModel) -> None:
    for key, bound in (("kp", model.kp), ("kd", model.kd)):
        section.check(key, Annotated[float, Meta(ge=0.0, le=bound if isfinite(bound) else 1e4)])
    if model.family == "odrive" and gains.kd == 0.0:
        raise section.refuse("kd", "an ODrive's stiffness works through its damping: give more than 0")


def _require_provable(section: ConfigReader, watchdog: str, model: CanActuatorModel) -> None:
    """Raises ConfigError for what the device cannot show: a voltage (it would never arm), a watchdog."""
    if section.has("supply") and model.family not in TELL_VOLTAGE:
        raise section.refuse("supply", f"a {model.name} does not tell its voltage: remove it")
    if watchdog == "none":
        choice = "unverified" if model.family in MUTE else "device"
        raise section.refuse("watchdog", f"a {model.name} has a watchdog: write `{choice}`")
    if watchdog == "device" and model.family in MUTE:
        raise section.refuse(
            "watchdog",
            f"a {model.name} cannot show over the bus that its watchdog is armed: set it by the vendor's "
            "tool, then say watchdog: unverified; every arming warns of it",
        )
