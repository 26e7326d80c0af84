"""Text of a robot file from a draft: each value with its source as a comment, each open item in `todo`."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from twind.command_line.verb import Rejected
from twind.config.actuator_types import TypeSpec
from twind.config.config_reader import ConfigReader
from twind.config.driver_family import BudgetRequest, DriverFamily, family_of
from twind.config.robot_file import FORMAT
from twind.config.robot_spec import RobotFile
from twind.config.travel import most_turns
from twind.config.yaml_tree import parse
from twind.ctl.robot_file_edit import TODO_COMMENT
from twind_calibration.drafting.robot_draft import FactSet, RobotDraft, find_device

RATES = (100, 50, 30, 20, 10)  # Hz, tried from the fastest
SEVERAL_TURNS = "extended_position"  # mode
SHARE = 0.95  # of the travel of its servo, where no source limits a joint


@dataclass(frozen=True)
class DraftedJoint:
    """A joint with everything that a robot file must say of it. `todo`: keys that no source states."""

    name: str
    model_joint: str
    bus: str
    id: int
    type_name: str
    kind: TypeSpec
    family: DriverFamily
    sign: int
    ratio: float
    lower: float
    upper: float
    velocity: float | None  # rad/s
    mode: str  # operating mode
    sources: str
    todo: tuple[str, ...]


@dataclass(frozen=True)
class FileAnswers:
    """Answers of the owner about the whole robot, and its model."""

    model: str  # name of the MJCF file
    base: str  # body
    passive: tuple[str, ...]  # joints of the model without a motor
    support: str | None  # None: unknown; written as fixed, and open
    bodiless: bool  # the model has joints alone
    no_watchdog: bool  # accepted: servos that hold their last goal when the daemon dies


def drafted_joints(draft: RobotDraft, devices: dict[str, str]) -> list[DraftedJoint]:
    """Return every joint, complete.

    `devices`: model by joint or by another software's name of it; "" for all others. Raises Rejected that
    names each joint, what is missing and the option that gives it.
    """
    if not draft.joints:
        raise Rejected("no joint: give --from FILE, --port BUS=PORT or --model FILE")
    joints: list[DraftedJoint] = []
    reasons: dict[str, list[str]] = {}  # names of the joints by what is missing
    for facts in draft.joints.values():
        try:
            joints.append(_joint(draft, facts, devices))
        except Rejected as error:
            reasons.setdefault(str(error), []).append(facts.name)
    if reasons:
        raise Rejected("\n".join(f"joint {', '.join(names)}: {reason}" for reason, names in reasons.items()))
    _require_one_kind(joints)
    return joints


def robot_text(draft: RobotDraft, joints: Sequence[DraftedJoint], answers: FileAnswers, rate: int) -> str:
    """Return the text of the robot file at a rate in Hz."""
    return "\n".join(_lines(draft, joints, answers, rate)) + "\n"


def fastest_rate(robot: RobotFile, families: dict[str, DriverFamily]) -> int:
    """Return the highest of RATES at which every bus of the robot has time for its joints.

    Raises Rejected with the arithmetic of the slowest bus.
    """
    reasons: list[str] = []
    for rate in RATES:
        reasons = []
        for bus in robot.buses:
            joints = [joint for joint in robot.joints if joint.bus == bus.name]
            refusal = families[bus.kind].budget(BudgetRequest(bus, joints, float(rate), None)).refusal
            if refusal:
                reasons.append(refusal)
        if not reasons:
            return rate
    raise Rejected("; ".join(reasons))


def _require_one_kind(joints: Sequence[DraftedJoint]) -> None:
    """Raises Rejected: devices of two families are on one bus."""
    for bus in dict.fromkeys(joint.bus for joint in joints):
        devices: dict[str, dict[str, None]] = {}
        for joint in joints:
            if joint.bus == bus:
                devices.setdefault(joint.family.kind, {})[joint.kind.device] = None
        if len(devices) > 1:
            kinds = "; ".join(f"{', '.join(models)} need kind {kind}" for kind, models in devices.items())
            raise Rejected(
                f"bus {bus} has devices of two kinds: {kinds}; say --device MODEL=MODEL, such as "
                "'MX-64=MX-64(1.0)' for Protocol 1.0, or another bus (--bus JOINT=BUS)"
            )


def _joint(draft: RobotDraft, facts: FactSet, devices: dict[str, str]) -> DraftedJoint:
    number = facts.get("id")
    if number is None:
        raise Rejected(
            "no source states its id; add a scan (--port BUS=PORT), or leave it out (--without JOINT)"
        )
    bus = _bus(draft, facts)
    device = _device(facts, devices, draft.bus(bus).get("protocol"))
    driver = family_of(device)
    kind = _read_type(driver, device)
    lower, upper, by, todo = _limits(facts, kind)
    if facts.get("sign") is None:
        todo = ("sign", *todo)
    said = {
        "id": facts.source("id"),
        "device": facts.source("device"),
        "limits": by,
        "sign": facts.source("sign"),
    }
    sources: dict[str, list[str]] = {}
    for what, source in said.items():
        if source:
            sources.setdefault(source, []).append(what)
    return DraftedJoint(
        name=facts.name,
        model_joint=facts.get("model_joint", facts.name),
        bus=bus,
        id=number,
        type_name=re.sub(r"[^a-z0-9]+", "_", device.casefold()).strip("_"),
        kind=kind,
        family=driver,
        sign=facts.get("sign", 1),
        ratio=facts.get("ratio", 1.0),
        lower=lower,
        upper=upper,
        velocity=facts.get("velocity"),
        mode=_mode(draft, facts, kind, upper - lower),
        sources="; ".join(f"{', '.join(what)} by {source}" for source, what in sources.items()),
        todo=todo,
    )


def _device(facts: FactSet, devices: dict[str, str], protocol: float | None) -> str:
    """Return the model. `protocol`: of the bus, where the joint's is not stated. Raises Rejected."""
    told = facts.get("device")
    named = (devices[key] for key in devices if key and fnmatchcase(facts.name, key))
    chosen = devices.get(facts.name) or devices.get(told or "") or next(named, None)
    if chosen is None and told is None:
        raise Rejected("no source states its model; say --device MODEL, or --device JOINT=MODEL")
    try:
        return find_device(chosen or str(told), facts.get("protocol", protocol))
    except Rejected as error:
        raise Rejected(
            f"{error}; say --device {told or 'JOINT'}=MODEL, or leave it out (--without JOINT)"
        ) from None


def _bus(draft: RobotDraft, facts: FactSet) -> str:
    bus = facts.get("bus")
    if bus is not None:
        return str(bus)
    if len(draft.buses) > 1:
        raise Rejected(
            f"on which of the buses {', '.join(draft.buses)}? Say --bus JOINT=BUS; "
            "JOINT may be a pattern, such as 'l_*'"
        )
    return next(iter(draft.buses), "main")


def _mode(draft: RobotDraft, facts: FactSet, kind: TypeSpec, travel: float) -> str:
    """Return the stated mode, else one that takes the travel (rad of the joint)."""
    stated = facts.get("mode")
    turns = travel * facts.get("ratio", 1.0) / (2.0 * math.pi)
    if stated or not kind.winds or turns <= most_turns(kind, kind.mode):
        return str(stated or kind.mode)
    draft.remarks.append(
        f"joint {facts.name}: its travel is {turns:.2f} turns of its servo: mode {SEVERAL_TURNS}; its turn "
        "is determined after each power-up"
    )
    return SEVERAL_TURNS


def _read_type(driver: DriverFamily, device: str) -> TypeSpec:
    text = f"device: {device}\n"
    return driver.read_type(device, ConfigReader(device, parse(text, device)))


def _limits(facts: FactSet, kind: TypeSpec) -> tuple[float, float, str, tuple[str, ...]]:
    """Return limits (rad), their source, and what is open: counts are about the middle of the servo."""
    unit = 2.0 * math.pi / kind.ticks_per_turn / facts.get("ratio", 1.0)
    turn = kind.ticks_per_turn * unit
    if "lower" in facts.facts and "upper" in facts.facts:
        return facts.get("lower"), facts.get("upper"), facts.source("lower"), ()
    if "lower_count" in facts.facts and "upper_count" in facts.facts:
        ends = [
            (facts.get(key) - kind.centre) * unit * facts.get("sign", 1)
            for key in ("lower_count", "upper_count")
        ]
        low, high = sorted(ends)
        if high - low < SHARE * turn:
            # Without a sign nobody knows which end is the upper one.
            todo = () if "sign" in facts.facts else ("limits_rad",)
            return _round(low), _round(high), facts.source("lower_count"), todo
    half = SHARE * turn / 2.0
    return _round(-half), _round(half), "", ("limits_rad",)


def _round(angle: float) -> float:
    return math.trunc(angle * 1e4) / 1e4


def _lines(
    draft: RobotDraft, joints: Sequence[DraftedJoint], answers: FileAnswers, rate: int
) -> Iterator[str]:
    types = {joint.type_name: joint for joint in joints}
    buses = {joint.bus: joint for joint in joints}
    yield f"# Robot file of {draft.name}, written by `twindctl robot new`."
    yield f"format: {FORMAT}"
    yield f"name: {draft.name}"
    yield f"model: {{mjcf: {answers.model}, base: {answers.base}}}"
    if answers.passive:
        yield f"passive: [{', '.join(answers.passive)}]"
    yield f"support: {answers.support or 'fixed'}"
    yield f"loop: {{rate_hz: {rate}}}"
    yield ""
    open_items = list(_todo(joints, types, answers))
    yield TODO_COMMENT
    yield "todo:"
    yield from (f"  - {item}" for item in open_items)
    yield ""
    yield "buses:"
    for name, joint in buses.items():
        facts = draft.buses.get(name)
        known = {"kind": joint.family.kind}
        if facts is not None and facts.get("baud"):
            known["baud"] = facts.get("baud")
        inside = ", ".join(f"{key}: {value}" for key, value in known.items())
        source = f"   # {facts.source('baud')}" if facts is not None and facts.get("baud") else ""
        yield f"  {name}: {{{inside}}}{source}"
    yield ""
    yield "types:   # speeds and gains are cautious defaults: docs/configuration.md has all keys"
    for name, joint in types.items():
        yield f"  {name}:"
        yield f"    device: {joint.kind.device}"
        if answers.no_watchdog and not joint.kind.watched:
            yield "    watchdog: none   # it holds its last goal when the daemon dies"
    yield ""
    yield "joints:"
    for joint in joints:
        parts = [f"id: {joint.id}", f"bus: {joint.bus}", f"type: {joint.type_name}", f"sign: {joint.sign}"]
        if joint.ratio != 1.0:
            parts.append(f"ratio: {joint.ratio:g}")
        if joint.mode != joint.kind.mode:
            parts.append(f"mode: {joint.mode}")
        if joint.model_joint != joint.name:
            parts.append(f"model_joint: {joint.model_joint}")
        if joint.velocity:
            parts.append(f"velocity_limit_rad_s: {joint.velocity:g}")
        parts.append(f"limits_rad: [{joint.lower:g}, {joint.upper:g}]")
        yield f"  {joint.name}: {{{', '.join(parts)}}}   # {joint.sources}"
    yield ""
    if answers.bodiless:
        yield "collision: {bodies: none}   # joints alone: neither collision nor torque is judged"
    yield "gate: {on_velocity: retime}   # a motion that is too fast is slowed down"
    yield ""
    yield "poses:"
    rest = {joint.name: min(max(0.0, joint.lower), joint.upper) for joint in joints}
    moved = ", ".join(f"{name}: {place:g}" for name, place in rest.items() if place)
    yield f"  rest: {{{moved}}}   # where torque may go off: nothing falls"


def _todo(
    joints: Sequence[DraftedJoint], types: dict[str, DraftedJoint], answers: FileAnswers
) -> Iterator[str]:
    if answers.support is None:
        yield "support"
    for name, joint in types.items():
        if not answers.no_watchdog and not joint.kind.watched:
            yield f"types.{name}.watchdog"
    for joint in joints:
        yield from (f"joints.{joint.name}.{key}" for key in joint.todo)
    yield "poses.rest"
