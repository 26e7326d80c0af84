"""Sections `types`, `actuators`, `transmissions`, `joints` of a robot file: who is turned by whom. Checked.

Every joint is driven once, by an actuator of its own or by one transmission; every actuator is used once.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twind.config.actuator_types import TypeSpec
from twind.config.bus_config import NAME
from twind.config.config_reader import ConfigReader, ConfigStruct, Text
from twind.config.driver_family import DriverFamily, SlotEntry, family, family_of, unknown_model
from twind.config.family_keys import Acceleration, FollowRad, FollowTime, SlotKeys, Speed
from twind.config.homing_config import HomingKeys, JointEndstops, homing, require_stops
from twind.config.robot_spec import ActuatorSlot, BusSpec, JointSpec, TransmissionSpec
from twind.config.transmission_config import transmissions
from twind.config.travel import most_turns
from twind.config.yaml_tree import ConfigError
from twind.robot.transmission import back, fair, span

SPEED = "velocity_limit_rad_s"
PULL = "acceleration_limit_rad_s2"
OF_ACTUATORS = ("bus", "id", "type", "sign", "ratio", "mode", "registers", "feedback_id")
OF_OWN_ACTUATORS = ("homing", "stop_rad", "stop_deg")  # what asks for an actuator of its own
OF_DEFAULTS = ("type", "bus", "sign", "ratio", "mode", SPEED, PULL)


class JointKeys(ConfigStruct, kw_only=True):
    """Keys of a joint, beside those of its slot."""

    limits_rad: tuple[float, float]
    """lower, upper | | accepted range, inclusive; at most one motor turn,
    [in some modes](../calibration/README.md#more-than-a-turn) more"""
    model_joint: Text | None = None
    """joint of the model | its own name |"""
    velocity_limit_rad_s: Speed = math.inf
    """as of a type | its type's | the tighter limit applies"""
    acceleration_limit_rad_s2: Acceleration = math.inf
    """as of a type | its type's | the tighter limit applies"""
    follow_rad: FollowRad | None = None
    """as of a type | its type's |"""
    follow_s: FollowTime | None = None
    """as of a type | its type's |"""
    stop_rad: JointEndstops
    homing: HomingKeys | None = None


class _TransmissionSlot(NamedTuple):
    """A joint's place in its transmission."""

    transmission: TransmissionSpec
    place: int

    @property
    def actuator(self) -> str:
        return self.transmission.actuators[self.place]


def described_joints(
    top: ConfigReader, wires: tuple[BusSpec, ...], folder: Path
) -> tuple[tuple[JointSpec, ...], tuple[TransmissionSpec, ...]]:
    """Joints in the order of the file, and what turns several of them. Raises ConfigError.

    `folder`: where the tables of linkages are sought.
    """
    defaults = top.section("defaults")
    defaults.require_known(OF_DEFAULTS)
    section = top.section("joints")
    entries = {name: each.inherit(defaults, OF_DEFAULTS) for name, each in section.sections().items()}
    others = top.section("actuators")
    if not entries:
        raise section.refuse("", "a robot needs at least one joint")
    slots = _SlotRegistry(top.section("types"), {bus.name: bus.kind for bus in wires})
    for name, entry in others.sections().items():
        if name in entries:
            raise others.refuse(name, "is the name of a joint too: a calibration could not tell them apart")
        slots.add(name, entry.inherit(defaults, OF_DEFAULTS))
    driven = transmissions(top.section("transmissions"), dict(slots.taken), others, section, folder)
    seats = {
        joint: _TransmissionSlot(each, place) for each in driven for place, joint in enumerate(each.joints)
    }
    joints = [_joint(name, entry, seats.get(name), slots) for name, entry in entries.items()]
    _once_each(joints, section)
    return tuple(_together(joints, driven, section)), driven


class _SlotRegistry:
    """The actuators read so far, by name: no two of one bus share an id, or a frame."""

    def __init__(self, types: ConfigReader, lines: Mapping[str, str]) -> None:
        self._kinds = types.sections()
        here = [family(kind) for kind in dict.fromkeys(lines.values())]
        self._types = {
            name: _with_follow(_read_type(name, each, here), each) for name, each in self._kinds.items()
        }
        self._lines = lines  # bus -> its kind
        self.taken: dict[str, ActuatorSlot] = {}

    def add(self, name: str, entry: ConfigReader, *beside: type) -> ActuatorSlot:
        """The actuator of an entry, which may have the keys of `beside` too. Raises ConfigError."""
        if not NAME.fullmatch(name):
            raise entry.refuse("", f"{name!r}: use 1 to 64 letters, digits, _ . and -")
        slot = self._read(name, entry, beside)
        for other in self.taken.values():
            if (other.bus, other.id) == (slot.bus, slot.id):
                raise entry.refuse("id", f"id {slot.id} on bus {slot.bus} is that of {other.name} already")
        family(slot.type.BUS).refuse_clash(slot, list(self.taken.values()), entry)
        self.taken[name] = slot
        return slot

    def _read(self, name: str, entry: ConfigReader, beside: tuple[type, ...]) -> ActuatorSlot:
        shapes = [family(kind).slot_keys for kind in self._lines.values()]
        entry.read(SlotKeys, *shapes, *beside)  # a misspelt key before a missing one
        kind = self._types[entry.choice("type", self._types)]
        bus = entry.choice("bus", self._lines)
        if self._lines[bus] != kind.BUS:
            device = f"type {kind.name} is a {kind.device}, for buses of kind {kind.BUS}"
            raise entry.refuse("bus", f"{device}; bus {bus} is of kind {self._lines[bus]}")
        return family(kind.BUS).read_slot(SlotEntry(name, bus, entry, self._kinds[kind.name], beside), kind)


def _read_type(name: str, entry: ConfigReader, here: Sequence[DriverFamily]) -> TypeSpec:
    """Return the type. Raises ConfigError; an unknown model or one of another bus before a wrong key."""
    device = entry.value("device", Text)
    driver = family_of(device, here)
    try:
        return driver.read_type(name, entry)
    except ConfigError as error:
        if error.path.endswith(".device"):
            raise
        if not driver.knows(device):
            message = unknown_model(device)
        elif driver not in here:
            kinds = ", ".join(each.kind for each in here)
            message = f"{device} is for buses of kind {driver.kind}; the buses here are of kind {kinds}"
        else:
            raise
        raise entry.refuse("device", message) from None


def _with_follow(kind: TypeSpec, section: ConfigReader) -> TypeSpec:
    """Return a type with the bounds of FOLLOW_ERR of its entry, which are those of all families."""
    kinds: Mapping[str, Any] = {"follow_rad": FollowRad, "follow_s": FollowTime}
    return replace(kind, **{key: section.value(key, kinds[key]) for key in kinds if section.has(key)})


def _joint(name: str, entry: ConfigReader, seat: _TransmissionSlot | None, slots: _SlotRegistry) -> JointSpec:
    if seat is not None:
        _refuse_own(entry, seat)
        slot = slots.taken[seat.actuator]
        given = entry.read(JointKeys)
    else:
        slot = slots.add(name, entry, JointKeys)
        given = entry.read(JointKeys, family(slot.type.BUS).slot_keys)
    lower, upper = given.limits_rad
    _require_limits(entry, lower, upper)
    if seat is None:
        _require_travel(slot, (lower, upper), entry)
    require_stops(entry, given.stop_rad, lower, upper)
    own_speed = given.velocity_limit_rad_s
    own_pull = given.acceleration_limit_rad_s2
    kind = slot.type
    return JointSpec(
        name=name,
        model_joint=given.model_joint or name,
        bus=slot.bus,
        id=slot.id,
        type=kind,
        sign=slot.sign,
        ratio=slot.ratio,
        lower=lower,
        upper=upper,
        velocity_limit=own_speed if seat else min(kind.velocity_limit_rad_s / slot.ratio, own_speed),
        acceleration_limit=own_pull if seat else min(kind.acceleration_limit_rad_s2 / slot.ratio, own_pull),
        registers=slot.registers,
        mode=slot.mode,
        feedback_id=slot.feedback_id,
        actuator=slot.name,
        transmission=seat.transmission.name if seat else "",
        stops=given.stop_rad,
        homing=homing(entry, given.homing, given.stop_rad),
        own_follow_rad=given.follow_rad,
        own_follow_s=given.follow_s,
    )


def _refuse_own(entry: ConfigReader, seat: _TransmissionSlot) -> None:
    """A joint of a transmission has no actuator of its own. Raises ConfigError where it has keys of one."""
    turned = f"driven through transmission {seat.transmission.name}"
    for key in entry:
        if key in OF_ACTUATORS:
            raise entry.refuse(key, f"{turned}: {key} stands with its actuator {seat.actuator}; remove it")
        if key in OF_OWN_ACTUATORS:
            raise entry.refuse(key, f"{turned}: no actuator drives it alone to a stop; remove it")


def _once_each(joints: Sequence[JointSpec], section: ConfigReader) -> None:
    """No joint of the model is driven twice. Raises ConfigError."""
    driven: dict[str, str] = {}
    for joint in joints:
        if (other := driven.get(joint.model_joint)) is not None:
            message = f"model joint {joint.model_joint} is driven by {other} already"
            raise section.section(joint.name).refuse("model_joint", message)
        driven[joint.model_joint] = joint.name


def _together(
    joints: Sequence[JointSpec], driven: Sequence[TransmissionSpec], section: ConfigReader
) -> list[JointSpec]:
    """The joints of transmissions with what their actuators together can. Raises ConfigError.

    Speeds and accelerations are such that all joints of a transmission may have theirs at once.
    """
    by_name = {joint.name: joint for joint in joints}
    for each in driven:
        own = [by_name[name] for name in each.joints]
        share = back(each.law)
        low, high = span(each.law, *(np.array([getattr(j, end) for j in own]) for end in ("lower", "upper")))
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            message = (
                f"the table of transmission {each.name} ends within the limits of {', '.join(each.joints)}"
            )
            raise section.section(own[0].name).refuse("limits_rad", message)
        speed, pull = (
            fair(share, np.array([getattr(j.type, of_type) / j.ratio for j in own]), np.array(of_own))
            for of_type, of_own in (
                (SPEED, [j.velocity_limit for j in own]),
                (PULL, [j.acceleration_limit for j in own]),
            )
        )
        for place, joint in enumerate(own):
            travel = float(low[place]), float(high[place])
            _require_travel(joint, travel, section.section(joint.name))
            by_name[joint.name] = replace(
                joint,
                velocity_limit=float(speed[place]),
                acceleration_limit=float(pull[place]),
                travel=travel,
            )
    return list(by_name.values())


def _require_travel(slot: ActuatorSlot | JointSpec, travel: tuple[float, float], entry: ConfigReader) -> None:
    turns = (travel[1] - travel[0]) * slot.ratio / (2.0 * math.pi)
    most = most_turns(slot.type, slot.mode)
    if turns > most:
        name = "the actuator" if isinstance(slot, ActuatorSlot) else f"actuator {slot.actuator}"
        remedy = "narrow it, or lower ratio"
        if slot.type.winds and most <= 1.0:
            remedy = f"{remedy}, or take a mode of several turns"
        raise entry.refuse(
            "limits_rad",
            f"the travel is {turns:.2f} turns of {name}, more than {most:g} in mode {slot.mode}: {remedy}",
        )


def _require_limits(entry: ConfigReader, lower: float, upper: float) -> None:
    if not lower < upper:
        raise entry.refuse("limits_rad", f"lower {lower:g} is not below upper {upper:g}")
    if not -20.0 * math.pi <= lower <= upper <= 20.0 * math.pi:
        raise entry.refuse(
            "limits_rad", f"{lower:g}..{upper:g} rad: more than ten turns; degrees by mistake?"
        )
