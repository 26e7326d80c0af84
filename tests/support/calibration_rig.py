"""A virtual robot of which nothing is known but its robot file, and the hands that move its limp joints."""

from collections.abc import Mapping
from pathlib import Path

from tests.support.daemon_rig import Rig
from twind.config.calibrated_device import make_device_record
from twind.config.calibration_file import Calibration, dump_calibration, read_calibration
from twind.config.counts import slot_angles
from twind.config.robot_file import load_robot
from twind.loop.tick.bound_robot import BoundRobot
from twind.robot.modes import Mode
from twind.twin.binding import bind
from twind.virtual.robot_ground_truth import RobotGroundTruth
from twind_calibration.calibrating.calibration_actuators import slots
from twind_calibration.calibrating.calibration_context import CalibrationContext
from twind_calibration.calibrating.encoder_unwrap import EncoderSample
from twind_calibration.calibrating.entry_writer import merged
from twind_calibration.calibrating.joint_capture import JointCapture, capture
from twind_calibration.calibrating.sweep_tracker import SweepEvent, SweepTracker
from twind_calibration.calibrating.zero_command import RecordedTravel, place_slot
from twind_calibration.calibrating.zero_placement import travel_of

QUICK = 5.0  # rad/s of a hand
WELL = 3  # ticks of 4096 that a zero may be off


def many_turns(folder: Path) -> str:
    """The robot file of h24 with servos that take goals over several turns: no seam is in their way."""
    known = load_robot("h24")
    text = known.path.read_text().replace("mode: position", "mode: extended_position")
    made = folder / "h24.yaml"
    made.write_text(text.replace("mjcf: h24.xml", f"mjcf: {known.mjcf_path}"))
    return str(made)


def uncalibrated(robot: str, truth: RobotGroundTruth) -> Rig:
    """In mirror, without a calibration."""
    rig = Rig(robot, Mode.MIRROR, truth=truth)
    restarted(rig, None, Mode.MIRROR)
    return rig


def restarted(rig: Rig, calibration: Calibration | None, mode: Mode) -> None:
    """The daemon ends, and another one begins on the same servos."""
    rig.loop.close()
    rig.front.end(rig.clock.now())
    rig.one = BoundRobot(rig.robot, calibration, bind(rig.robot, calibration))
    rig.front = rig.new_front()
    rig.loop = rig.born(mode)
    rig.connect()


def hands(rig: Rig, pose: Mapping[str, float]) -> None:
    """Take the slot of every joint there, on whatever bus it is; stops are felt."""
    for bus in rig.robot.buses:
        own = {joint.name: pose[joint.name] for joint in rig.robot.joints if joint.bus == bus.name}
        rig.virtual[bus.name].faults.hand(pose=own, speed=QUICK)


def encoder_samples(rig: Rig) -> dict[str, EncoderSample]:
    """Messages of topic `raw`."""
    raw = rig.loop.hardware.readings.raw
    names = [slot.name for slot in slots(rig.robot)]
    return {
        name: EncoderSample(float(at), int(ticks))
        for name, at, ticks in zip(names, raw.heard_at, raw.ticks, strict=True)
        if at > 0.0
    }


def sweep_all(rig: Rig, beyond: float = 1.0) -> SweepTracker:
    """Every actuator taken `beyond` (rad) both ends of what is described, or to its stop; a rest at each."""
    travels = SweepTracker(slots(rig.robot), [slot.name for slot in slots(rig.robot)])
    news = moved(rig, travels, beyond)
    assert not [one for one in news if one.what != "done"], news
    assert travels.is_finished
    return travels


def moved(rig: Rig, travels: SweepTracker, beyond: float = 1.0) -> list[SweepEvent]:
    """Sweep events while hands move every joint past both ends."""
    every = slots(rig.robot)
    news = []
    for side, way in (("upper", beyond), ("lower", -beyond)):
        hands(rig, {slot.joint.name: getattr(slot, side) + way for slot in every})
        for _ in range(200):
            rig.ticks(1)
            news += travels.take(encoder_samples(rig))
    return news


def held(rig: Rig, pose: Mapping[str, float]) -> dict[str, JointCapture]:
    """50 readings of every joint in a pose."""
    hands(rig, slot_angles(rig.robot, pose))
    rig.seconds(1.5)
    readings: dict[str, list[int]] = {slot.name: [] for slot in slots(rig.robot)}
    for _ in range(50):
        rig.ticks(1)
        for name, sample in encoder_samples(rig).items():
            readings[name].append(sample.ticks)
    return {
        slot.name: capture(readings[slot.name], slot.joint.type.ticks_per_turn) for slot in slots(rig.robot)
    }


def measured(
    rig: Rig, travels: SweepTracker, captures: Mapping[str, JointCapture], pose: Mapping[str, float]
) -> Calibration:
    """The file that sweep and zero would have written."""
    found = {(port.name, device.id): device for port in rig.loop.hardware.ports for device in port.devices}
    angles = slot_angles(rig.robot, pose)
    entries = []
    for slot in slots(rig.robot):
        record = make_device_record(found[slot.joint.bus, slot.joint.id])
        travel = travels.travel(slot.name)
        assert travel is not None, slot.name
        known = RecordedTravel(record, travel_of(slot, record, travel))
        placed = place_slot(slot, known, record, captures[slot.name], angles[slot.joint.name])
        assert placed.entry is not None, (slot.name, placed.wrong)
        entries.append(placed.entry)
    made = merged(CalibrationContext(rig.robot, Path("h24.yaml"), named=False), None, entries)
    return read_calibration(dump_calibration(made), "h24.yaml", rig.robot)


def off(rig: Rig, calibration: Calibration) -> dict[str, int]:
    """Distance of each zero from the true one, ticks, whatever the turn."""
    found = {}
    for joint in rig.robot.joints:
        turn = joint.type.ticks_per_turn
        apart = calibration.by_name[joint.actuator].zero_ticks - rig.made.shown[joint.name]
        found[joint.name] = (apart + turn // 2) % turn - turn // 2
    return found
