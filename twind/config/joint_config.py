"""Sections `types`, `actuators`, `transmissions`, `joints` of a robot file: who is turned by whom. Checked.

Every joint is driven once, by an actuator of its own or by one transmission; every actuator is used once.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

import numpy as np

from twind.config.actuator_types import CanType, ServoType, TypeSpec
from twind.config.bus_config import NAME
from twind.config.can_type import can_joint, can_type, refuse_clash
from twind.config.config_section import ConfigSection
from twind.config.homing_config import homing, stops
from twind.config.robot_spec import ActuatorSlot, BusSpec, JointSpec, TransmissionSpec
from twind.config.servo_type import servo_joint, servo_type
from twind.config.transmission_config import transmissions
from twind.robot.transmission import back, fair, span
from twind_drivers.can.can_models import MODELS as CAN_MODELS
from twind_drivers.dynamixel.control_tables import number_of

SPEED = "velocity_limit_rad_s"
PULL = "acceleration_limit_rad_s2"
OF_ACTUATORS = ("bus", "id", "type", "sign", "ratio", "mode", "registers", "feedback_id")
OF_OWN_ACTUATORS = ("homing", "stop_rad")  # what asks for an actuator that turns this joint alone


@dataclass(frozen=True, slots=True)
class _EntryContext:
    """What entries refer to."""

    defaults: ConfigSection
    kinds: ConfigSection
    types: Mapping[str, TypeSpec]
    lines: Mapping[str, str]  # bus -> its kind

    def source(self, entry: ConfigSection) -> Callable[[str], ConfigSection]:
        """Where a key of an entry stands: with the entry, else under `defaults`."""

        def source(key: str) -> ConfigSection:
            common = self.defaults.has(key)  # asked in any case, so that the key is known
            return self.defaults if common and not entry.has(key) else entry

        return source


def described_joints(
    top: ConfigSection, wires: tuple[BusSpec, ...], folder: Path
) -> tuple[tuple[JointSpec, ...], tuple[TransmissionSpec, ...]]:
    """Joints in the order of the file, and what turns several of them. Raises ConfigError.

    `folder`: where the tables of linkages are sought.
    """
    kinds = top.section("types")
    types = {name: _type(name, kinds) for name in kinds}
    kinds.close()
    ground = _EntryContext(top.section("defaults"), kinds, types, {bus.name: bus.kind for bus in wires})
    section = top.section("joints")
    others = top.section("actuators")
    if not list(section):
        raise section.refuse("", "a robot needs at least one joint")
    slots = _SlotRegistry(ground)
    for name in others:
        if name in tuple(section):
            raise others.refuse(name, "is the name of a joint too: a calibration could not tell them apart")
        entry = others.section(name)
        slots.add(name, entry)
        entry.close()
    others.close()
    made = {each.name: each for each in slots.taken}
    driven = transmissions(top.section("transmissions"), made, others, section, folder)
    seats = {
        joint: _TransmissionSlot(each, place) for each in driven for place, joint in enumerate(each.joints)
    }
    joints = [_joint(name, section.section(name), seats.get(name), slots, ground) for name in section]
    _once_each(joints, section)
    section.close()
    ground.defaults.close()
    return tuple(_together(joints, driven, section)), driven


class _TransmissionSlot(NamedTuple):
    """A joint's place in its transmission."""

    transmission: TransmissionSpec
    place: int

    @property
    def actuator(self) -> str:
        return self.transmission.actuators[self.place]


class _SlotRegistry:
    """The actuators read so far: no two of one bus share an id, or a frame."""

    def __init__(self, ground: _EntryContext) -> None:
        self._ground = ground
        self.taken: list[ActuatorSlot] = []

    def add(self, name: str, entry: ConfigSection) -> ActuatorSlot:
        """The actuator that an entry describes. Raises ConfigError."""
        if not NAME.fullmatch(name):
            raise entry.refuse("", f"{name!r}: use 1 to 64 letters, digits, _ . and -")
        slot = _slot(name, entry, self._ground)
        for other in self.taken:
            if (other.bus, other.id) == (slot.bus, slot.id):
                raise entry.refuse("id", f"id {slot.id} on bus {slot.bus} is that of {other.name} already")
        refuse_clash(slot, self.taken, entry)
        self.taken.append(slot)
        return slot

    def find_slot(self, name: str) -> ActuatorSlot:
        """One that was read. Raises KeyError."""
        return {slot.name: slot for slot in self.taken}[name]


def _slot(name: str, entry: ConfigSection, ground: _EntryContext) -> ActuatorSlot:
    source = ground.source(entry)
    kind = ground.types[source("type").text("type", None, tuple(ground.types))]
    sign = source("sign").integer("sign", 1)
    if sign not in (1, -1):
        raise source("sign").refuse("sign", f"{sign} is neither 1 nor -1")
    ratio = source("ratio").number("ratio", 1.0, above=0.0, most=1000.0)
    bus = source("bus").text("bus", None, tuple(ground.lines))
    if ground.lines[bus] != kind.BUS:
        device = f"type {kind.name} is a {kind.device}, for buses of kind {kind.BUS}"
        raise entry.refuse("bus", f"{device}; bus {bus} is of kind {ground.lines[bus]}")
    registers: Mapping[str, int] = {}
    feedback: int | None = None
    if isinstance(kind, CanType):
        id, mode, feedback = can_joint(source, entry, kind)
    else:
        assert isinstance(kind, ServoType)
        id, mode, registers = servo_joint(source, entry, kind, ground.kinds.section(kind.name))
    return ActuatorSlot(name, bus, id, kind, sign, ratio, registers, mode, feedback)


def _joint(
    name: str,
    entry: ConfigSection,
    seat: _TransmissionSlot | None,
    slots: _SlotRegistry,
    ground: _EntryContext,
) -> JointSpec:
    if seat is not None:
        _refuse_own(entry, seat)
        slot = slots.find_slot(seat.actuator)
    else:
        slot = slots.add(name, entry)
    lower, upper = _limits(entry)
    if seat is None:
        _within_a_turn(slot, (lower, upper), entry, "limits_rad")
    ends = stops(entry, lower, upper)
    source = ground.source(entry)
    own_speed = source(SPEED).number(SPEED, math.inf, above=0.0, most=100.0)
    own_pull = source(PULL).number(PULL, math.inf, above=0.0, most=1e4)
    kind = slot.type
    joint = JointSpec(
        name=name,
        model_joint=entry.text("model_joint", name),
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
        stops=ends,
        homing=homing(entry, ends),
    )
    entry.close()
    return joint


def _refuse_own(entry: ConfigSection, seat: _TransmissionSlot) -> None:
    """A joint of a transmission has no actuator of its own to speak of."""
    turned = f"driven through transmission {seat.transmission.name}"
    for key in OF_ACTUATORS:
        if entry.has(key):
            raise entry.refuse(key, f"{turned}: {key} stands with its actuator {seat.actuator}; remove it")
    for key in OF_OWN_ACTUATORS:
        if entry.has(key):
            raise entry.refuse(key, f"{turned}: no actuator drives it alone to a stop; remove it")


def _once_each(joints: Sequence[JointSpec], section: ConfigSection) -> None:
    """No joint of the model is driven twice. Raises ConfigError."""
    driven: dict[str, str] = {}
    for joint in joints:
        if (other := driven.get(joint.model_joint)) is not None:
            message = f"model joint {joint.model_joint} is driven by {other} already"
            raise section.section(joint.name).refuse("model_joint", message)
        driven[joint.model_joint] = joint.name


def _together(
    joints: Sequence[JointSpec], driven: Sequence[TransmissionSpec], section: ConfigSection
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
            _within_a_turn(joint, travel, section.section(joint.name), "limits_rad")
            by_name[joint.name] = replace(
                joint,
                velocity_limit=float(speed[place]),
                acceleration_limit=float(pull[place]),
                travel=travel,
            )
    return list(by_name.values())


def _within_a_turn(
    slot: ActuatorSlot | JointSpec, travel: tuple[float, float], entry: ConfigSection, key: str
) -> None:
    turns = (travel[1] - travel[0]) * slot.ratio / (2.0 * math.pi)
    if turns > 1.0:
        name = "the actuator" if isinstance(slot, ActuatorSlot) else f"actuator {slot.actuator}"
        raise entry.refuse(key, f"the travel is {turns:.2f} turns of {name}: one turn at most without homing")


def _type(name: str, parent: ConfigSection) -> TypeSpec:
    """By its device: a model of one of the CAN families, else a serial servo."""
    section = parent.section(name)
    device = section.text("device")
    if device in CAN_MODELS:
        return can_type(name, section)
    near = get_close_matches(device, CAN_MODELS, 1, 0.75)
    if near and device.lower() != near[0].lower() and not _is_servo(device):
        raise section.refuse("device", f"no CAN actuator {device!r}; nearest: {near[0]}")
    return servo_type(name, section)


def _is_servo(device: str) -> bool:
    try:
        return number_of(device) > 0
    except KeyError:
        return False


def _limits(entry: ConfigSection) -> tuple[float, float]:
    lower, upper = entry.numbers("limits_rad", 2)
    if not lower < upper:
        raise entry.refuse("limits_rad", f"lower {lower:g} is not below upper {upper:g}")
    if not -20.0 * math.pi <= lower <= upper <= 20.0 * math.pi:
        raise entry.refuse(
            "limits_rad", f"{lower:g}..{upper:g} rad: more than ten turns; degrees by mistake?"
        )
    return lower, upper
