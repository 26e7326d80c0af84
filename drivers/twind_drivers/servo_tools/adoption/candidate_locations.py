"""Ids and baud rates at which a new servo may answer, and assignment of found servos to joints.

A servo gets its settings at its factory id and rate, then its id, then the rate of the bus. After an
interruption it is therefore at one of three locations, and each is recognised. The id is written first: most
servos are delivered with id 1, which at the rate of the bus may be the id of a joint.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from twind.command_line.verb import Rejected
from twind.config.robot_spec import BusSpec, JointSpec, RobotFile
from twind_calibration.rejection_hints import unknown_joint
from twind_drivers.servo_tools.bus_scan import BaudRateScan, ScanFaultKind, ScannedDevice, ids_of, scan
from twind_drivers.servo_tools.family_tools import FamilyTools, ServoLocation, need_tools, tools_of
from twind_drivers.servo_tools.prober import PortProber

Heard = Mapping[str, Sequence[BaudRateScan]]  # by bus: what each rate that was looked at gave


@dataclass(frozen=True, slots=True)
class AdoptionCandidate:
    """A servo on the wire, and its intended joint."""

    joint: JointSpec
    bus: BusSpec
    place: ServoLocation
    found: ScannedDevice

    @property
    def tools(self) -> FamilyTools:
        """Tools of its family."""
        return need_tools(self.bus.kind)

    @property
    def home(self) -> ServoLocation:
        """Id and rate of the servo after adoption."""
        return ServoLocation(self.joint.id, self.bus.baud)

    @property
    def new(self) -> bool:
        """True if it is not at its place yet."""
        return self.place != self.home


def delivered(joint: JointSpec) -> Sequence[ServoLocation]:
    """Return where the servo model of this joint may answer as delivered. Raises Rejected: not known."""
    places = need_tools(joint.type.BUS).delivered(joint.type.device)
    if not places:
        raise Rejected(
            f"{joint.type.device}: where it answers as delivered is not known: give it its id by hand"
        )
    return places


def ways(robot: RobotFile, joint: JointSpec) -> tuple[ServoLocation, ...]:
    """Return every location of the new servo of `joint`: factory settings, intermediate, final.

    Excluded are the locations of other joints, and id 1 at the rate of the bus where a joint has id 1.
    """
    baud = robot.bus(joint.bus).baud
    others = {each.id for each in robot.joints if each.bus == joint.bus and each.name != joint.name}
    places = [
        place
        for fresh in delivered(joint)
        for place in (fresh, ServoLocation(joint.id, fresh.baud), ServoLocation(fresh.id, baud))
    ]
    places = [
        *(each for each in places if each.baud != baud or each.id != joint.id),
        ServoLocation(joint.id, baud),
    ]
    return tuple(dict.fromkeys(each for each in places if each.baud != baud or each.id not in others))


def search_plan(robot: RobotFile, bus: BusSpec) -> dict[int, range]:
    """Map each rate to the ids to search: the joints' ids at the bus's rate, all ids at factory rates."""
    fresh = [place for joint in robot.joints if joint.bus == bus.name for place in delivered(joint)]
    ids = [joint.id for joint in robot.joints if joint.bus == bus.name]
    known = range(max([*ids, *(each.id for each in fresh)], default=0) + 1)
    return {bus.baud: known} | {each.baud: ids_of(need_tools(bus.kind).protocol) for each in fresh}


def look(at: Callable[[int], PortProber], robot: RobotFile, bus: BusSpec) -> list[BaudRateScan]:
    """Scan a bus at the rates and ids of its `search_plan`. Writes nothing. Raises PortError."""
    return [each for baud, ids in search_plan(robot, bus).items() for each in scan(at, [baud], ids)]


def joint_of(robot: RobotFile, name: str) -> JointSpec:
    """Return the joint of that name, or the joint of the actuator of that name.

    Raises Rejected: no such joint (the message names the nearest), or a joint without serial servo.
    """
    joint = {name: each for each in robot.joints for name in (each.actuator, each.name)}.get(name)
    if joint is None:
        raise unknown_joint(robot.name, name, robot.names)
    if tools_of(joint.type.BUS) is None:
        answers = "" if joint.feedback_id is None else f", and {joint.feedback_id} to answer with"
        raise Rejected(
            f"{name} is a {joint.type.device} on {_describe(robot.bus(joint.bus))}. Give "
            f"it id {joint.id}{answers} at {robot.bus(joint.bus).baud} bit/s with its maker's tool; then "
            f"`twindctl scan {joint.bus}` with the daemon in mode mirror shows whether it answers"
        )
    return joint


def serial_buses(robot: RobotFile) -> tuple[BusSpec, ...]:
    """Return the buses that support adoption. Raises Rejected where there is none."""
    found = tuple(bus for bus in robot.buses if tools_of(bus.kind) is not None)
    if not found:
        has = " and ".join(dict.fromkeys(bus.kind for bus in robot.buses))
        raise Rejected(
            f"{robot.name} has {has} buses only, and adopt sets up servos of other kinds: name a JOINT for "
            "what to do"
        )
    return found


def _describe(bus: BusSpec) -> str:
    if bus.kind == "can":
        return f"CAN bus {bus.name}: adopt sets up serial servos only"
    return f"bus {bus.name}: adopt does not know servos of kind {bus.kind}"


def choose(robot: RobotFile, responding: Heard, name: str | None) -> AdoptionCandidate | None:
    """Choose the new servo and its joint; None: every joint of these buses has its servo.

    `responding` is the result of `look`. `name`: the joint; without it, the missing one. Raises Rejected with
    cause and remedy: several joints missing, two new servos or none, another model, torque on, a hardware
    error, an id that answers twice.
    """
    for bus, lines in responding.items():
        _require_quiet(bus, lines)
    absent = missing(robot, responding)
    if name is not None:
        joint = joint_of(robot, name)
    elif not absent:
        return None
    elif len(absent) > 1:
        shown = ", ".join(f"{each.name} ({each.bus} id {each.id})" for each in absent)
        raise Rejected(f"{len(absent)} joints have no servo: {shown}. Say which: `twindctl adopt JOINT`")
    else:
        [joint] = absent
    wire = robot.bus(joint.bus)
    found = {ServoLocation(each.id, each.baud): each for line in responding[wire.name] for each in line.found}
    place = _alone(joint, found) if name is not None else None
    place = place or _only(robot, joint, found)
    _require_fit(joint, place, found[place])
    return AdoptionCandidate(joint, wire, place, found[place])


def missing(robot: RobotFile, responding: Heard) -> list[JointSpec]:
    """Return the joints of these buses whose servos do not answer at the bus's rate, in order."""
    there = {
        (bus, each.id, each.baud)
        for bus, lines in responding.items()
        for line in lines
        for each in line.found
    }
    return [
        joint
        for joint in robot.joints
        if joint.bus in responding and (joint.bus, joint.id, robot.bus(joint.bus).baud) not in there
    ]


def _require_quiet(bus: str, lines: Sequence[BaudRateScan]) -> None:
    for line in lines:
        for trouble in line.troubles:
            if trouble.kind is ScanFaultKind.TALK:
                raise Rejected(f"bus {bus}, {line.baud} baud: {trouble}; end it first")


def _alone(joint: JointSpec, found: Mapping[ServoLocation, ScannedDevice]) -> ServoLocation | None:
    """Return where the only servo on the bus answers, if it may be a new one; None: it is not alone there.

    At the rate of the bus its id can be that of another joint: with all others away it is the named one.
    """
    places = list(found)
    return places[0] if len(places) == 1 and places[0] in delivered(joint) else None


def _only(robot: RobotFile, joint: JointSpec, found: Mapping[ServoLocation, ScannedDevice]) -> ServoLocation:
    """Return the location of the only candidate servo."""
    bus = robot.bus(joint.bus)
    home = ServoLocation(joint.id, bus.baud)
    candidates = [each for each in ways(robot, joint) if each in found]
    strangers = [each for each in found if each.baud != bus.baud and each not in candidates]
    if len(candidates) + len(strangers) > 1 and home in found:
        others = _format_list([each for each in [*candidates, *strangers] if each != home])
        raise Rejected(
            f"{joint.name} has a servo already, {home}, and there is a new one, {others}: take one of them "
            "off the bus, or name the joint that is missing"
        )
    if len(candidates) + len(strangers) > 1:
        raise Rejected(
            f"bus {bus.name} has several new servos: {_format_list([*candidates, *strangers])}; "
            f"connect one new servo at a time{_unfinished(robot, joint, strangers)}"
        )
    if strangers:
        raise Rejected(
            f"bus {bus.name}: {strangers[0]} is no place of a new {joint.type.device}, which is "
            f"{_format_list(delivered(joint), ' or ')}: set "
            f"it back to factory settings, or take it off the bus{_unfinished(robot, joint, strangers)}"
        )
    if not candidates:
        raise Rejected(f"no new servo on bus {bus.name}: {' '.join(_silence(robot, joint))}")
    return candidates[0]


def _silence(robot: RobotFile, joint: JointSpec) -> Iterator[str]:
    bus = robot.bus(joint.bus)
    fresh = delivered(joint)
    usual = _format_list(fresh, " or ")
    yield f"a {joint.type.device} as delivered is {usual}, and no new one answers there."
    ids = [each.id for each in fresh if each.baud == bus.baud]
    owner = [each.name for each in robot.joints if each.bus == bus.name and each.id in ids]
    if owner and owner[0] != joint.name:
        yield (
            f"The servo that answers there is {owner[0]}'s: with the new one alone on the port "
            f"`twindctl adopt {joint.name}` does the rest."
        )
        return
    yield "Is it powered, and its data line connected? With other settings than the factory's it is found by"
    yield "`twindctl scan --port PORT`: set it back to factory settings."


def _unfinished(robot: RobotFile, joint: JointSpec, strangers: Sequence[ServoLocation]) -> str:
    """Return a hint that names another joint whose adoption was started and not completed.

    One of the unexpected locations shows it. Empty where there is none.
    """
    begun = [
        each.name
        for each in robot.joints
        if each.bus == joint.bus and each.name != joint.name
        for place in strangers
        if place.id == each.id and any(place.baud == fresh.baud for fresh in delivered(each))
    ]
    return "" if not begun else f"; one may be begun for {begun[0]}: `twindctl adopt {begun[0]}` ends that"


def _format_list(places: Sequence[ServoLocation], comma: str = ", ") -> str:
    return comma.join(str(each) for each in sorted(places, key=lambda each: (each.baud, each.id)))


def _require_fit(joint: JointSpec, place: ServoLocation, found: ScannedDevice) -> None:
    """Raises Rejected: what answers there is no servo that may be written to."""
    tools = need_tools(joint.type.BUS)
    if found.trouble:
        raise Rejected(f"{place}: {found.trouble}")
    if found.model != tools.number_of(joint.type.device):
        model = found.model_name or f"a model that is in no table ({found.model})"
        raise Rejected(f"{place} is {model}; {joint.name} needs {joint.type.device}: connect one of those")
    if found.torque is not False:
        state = "on" if found.torque else "unknown (status return level?)"
        raise Rejected(
            f"{place}: its torque is {state}: take its power away and give it back, then try again"
        )
    if found.hardware_error is None or found.hardware_error:
        bits = found.hardware_error
        error = "unknown" if bits is None else f"{bits:#04x} ({tools.protocol.explain(bits)})"
        raise Rejected(f"{place}: its hardware error is {error}: find the cause, then restart it")
