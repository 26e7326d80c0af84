"""Looks at a CAN bus on its own channel: who answers, what they say, who else talks. Asks only."""

from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from twind.config.actuator_types import CanType
from twind.config.robot_spec import JointSpec
from twind.doctor.can_bus_inspector import CanBusInspector
from twind.doctor.check import CheckUnavailable
from twind.doctor.survey import PARAMETERS, CanSurvey, SurveyedCanActuator, is_queried
from twind_drivers.bus import Bools, DeviceRefused, NoReply, PortError, ReadRequest
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.channel import CanErrorState
from twind_drivers.can.register_access import STATE
from twind_drivers.run_script import perform

LISTEN = 0.12  # s: an ODrive tells its state ten times a second, another master speaks more often
AFTER = 0.01  # s after an answer in which a second one of the same id would come, or a late one
TRIES = 3  # of a question that one does not answer
# of questions to all; in so many a second answer must come before it counts
ROUNDS = 5
MOST = 3
UNTOLD = 255  # torque of an actuator that does not tell it
# Bits of a CAN actuator's fault, as the drivers tell them.
FAULTS = (
    *("input voltage", "not calibrated", "overheating", "encoder", "electrical shock", "overload"),
    *("lost its master", "a code that nobody knows"),
)
CONDITIONS = {
    CanErrorState.PASSIVE: "the controller is error passive: many frames are broken",
    CanErrorState.OFF: "the controller has left the bus, or nobody acknowledges its frames",
}


def survey_can_line(line: CanBusInspector) -> CanSurvey:
    """Everything of one bus. Raises CannotLook."""
    try:
        return _survey(line)
    except PortError as error:
        raise CheckUnavailable(str(error)) from error


def _survey(line: CanBusInspector) -> CanSurvey:
    reader = line.reader
    clock = line.clock
    clock.sleep_until(clock.now() + LISTEN)
    unasked = reader.fleet.decode_frames(line.channel.receive(clock.now()))
    perform(reader, reader.identify(), clock)  # ranges that they tell become those of the frames
    spoke, twice, strangers = _rounds(line)
    joints = [joint for joint in line.robot.joints if joint.bus == line.spec.name]
    if unasked.masters:  # then a second answer may be to the other master
        twice = set()
    nodes = tuple(_node(line, joint, twice=joint.id in twice) for joint in joints if joint.id in spoke)
    missing = tuple(joint for joint in joints if joint.id not in spoke and is_queried(joint))
    condition = CONDITIONS.get(line.channel.condition.line, "")
    return CanSurvey(
        line.spec, line.port, nodes, missing, condition, unasked.masters, unasked.strangers + strangers
    )


def _node(line: CanBusInspector, joint: JointSpec, *, twice: bool) -> SurveyedCanActuator:
    torque, fault = _state(line, joint.id)
    faults = tuple(name for bit, name in enumerate(FAULTS) if fault >> bit & 1)
    return SurveyedCanActuator(joint.bus, joint, _values(line, joint), torque, faults, twice)


def _state(line: CanBusInspector, id: int) -> tuple[int, int]:
    """Torque, -1: not told; fault bits."""
    for _ in range(TRIES):
        if id in (told := _ask(line)):
            torque, bits, known = told[id]
            return -1 if torque == UNTOLD else torque, bits if known else 0
    return -1, 0


def _rounds(line: CanBusInspector) -> tuple[set[int], set[int], int]:
    """All asked again and again: who answered, late or not; who answered more often than asked in most of the
    rounds (never who tells unasked); how many frames came of nobody.

    Not in each of them: a second answer may come too late, or the two may be one frame on the wire. Nor in
    any: where nobody was there to acknowledge, questions wait, and are then answered all at once.
    """
    reader = line.reader
    clock = line.clock
    spoke = np.zeros(len(reader.ids), np.bool_)
    more = np.zeros(len(reader.ids), np.int64)
    strangers = 0
    for _ in range(ROUNDS):
        _ask(line)
        count = reader.line.heard.count.copy()
        wanted = reader.line.expect.copy()
        clock.sleep_until(clock.now() + AFTER)
        late = reader.fleet.decode_frames(line.channel.receive(clock.now()))
        count += late.count
        strangers += reader.line.heard.strangers + late.strangers
        spoke |= count > 0
        more += count > wanted
    return _ids(reader, spoke), _ids(reader, reader.fleet.replies & (more >= MOST)), strangers


def _ids(reader: CanReader, rows: Bools) -> set[int]:
    return {id for id, chosen in zip(reader.ids, rows.tolist(), strict=True) if chosen}


def _ask(line: CanBusInspector) -> Mapping[int, bytes]:
    """What everybody says of torque and faults, by id."""
    reader = line.reader
    clock = line.clock
    reader.begin(ReadRequest(reader.ids, STATE, 3), clock.now())
    while not reader.feed(clock.now()) and clock.now() < reader.deadline:
        clock.wait([reader.channel], reader.deadline)
    return reader.answer(clock.now()).data


def _values(line: CanBusInspector, joint: JointSpec) -> Mapping[str, int]:
    """Registers by name, floats in thousandths; one that is not answered is left out."""
    assert isinstance(joint.type, CanType)
    found = {}
    for name in PARAMETERS[joint.type.family]:
        with suppress(NoReply, DeviceRefused):
            found[name] = perform(line.reader, line.reader.read(joint.id, name), line.clock).value
    return found
