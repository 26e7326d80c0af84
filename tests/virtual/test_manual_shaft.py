"""Somebody's hand on limp shafts: straight there, as fast as told, to the stop; never against torque."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_serial_host import Host
from twind.config.robot_file import load_robot
from twind.exceptions import InvalidInput
from twind.virtual.robot_ground_truth import JointGroundTruth, RobotGroundTruth
from twind.virtual.virtual_robot_spec import VirtualRobotSpec, buses, make_spec
from twind.virtual.virtual_server import ServoClock, VirtualBusServer
from twind_drivers.clock import FakeClock
from twind_drivers.virtual.servable_bus import ServableBus

H24 = load_robot("h24")
PER_RAD = 4096 / math.tau


# ---------------------------------------------------------------------------------------- one servo


@examples(20)
@given(st.integers(-6000, 9000), st.floats(0.1, 10.0), st.integers(2, 9))
def test_a_hand_goes_straight_there_and_stays(to: int, speed: float, looks: int) -> None:
    host = Host([1])
    host.bus.faults.hand(1, to=to, speed=speed)
    whole = abs(to - 2048) / (speed * PER_RAD)
    for look in range(1, looks + 1):
        host.wait(whole / looks)
        expected = 2048 + (to - 2048) * look / looks
        assert host.muscles.position[0] == pytest.approx(expected, abs=1e-6)
    host.wait(1.0)
    assert (host.present(1), host.read(1, 128, 4)) == (to, 0)
    host.bus.faults.hand(1, off=True)
    host.wait(1.0)
    assert host.present(1) == to, "nothing loads these joints"


def test_a_shaft_moved_by_hand_reports_its_speed_without_current() -> None:
    host = Host([1])
    host.bus.faults.hand(1, to=4000, speed=1.0)
    host.wait(0.1)
    assert host.read(1, 128, 4) == pytest.approx(60 / math.tau / 0.229, abs=1), "rad/s in 0.229 rpm"
    assert host.read(1, 126, 2) == 0, "no current: the motor is off"


@pytest.mark.parametrize("reverse", [False, True])
def test_to_is_what_the_present_position_shows(reverse: bool) -> None:
    host = Host([1], settings={"drive_mode": int(reverse), "homing_offset": 300})
    host.bus.faults.hand(1, to=2500, speed=20.0)
    host.wait(2.0)
    assert host.present(1) == 2500


def test_a_hand_slips_where_torque_is_on_and_has_the_shaft_when_that_goes() -> None:
    host = Host([1, 2])
    host.goal(1, 2048)
    host.torque(1)
    host.bus.faults.hand(1, to=3000)
    host.bus.faults.hand(2, to=3000)
    host.wait(3.0)
    assert (host.present(1), host.present(2)) == (2048, 3000)
    host.torque(1, on=False)
    host.wait(3.0)
    assert host.present(1) == 3000


def test_a_hand_does_not_turn_what_is_held_fast() -> None:
    host = Host([1])
    host.bus.faults.lock(1)
    host.bus.faults.hand(1, to=3000)
    host.wait(3.0)
    assert host.present(1) == 2048
    host.bus.faults.free(1)
    host.wait(3.0)
    assert host.present(1) == 3000


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ({}, "it is id with one of"),
        ({"id": 1}, "it is id with one of"),
        ({"id": 1, "to": 1, "rad": 1.0}, "it is id with one of"),
        ({"id": 1, "to": 1, "off": True}, "it is id with one of"),
        ({"to": 1}, "it is id with one of"),
        ({"id": 1, "pose": {"x": 1.0}}, "it is id with one of"),
        ({"id": 1, "to": math.nan}, "to is nan"),
        ({"id": 1, "to": 1, "speed": 0.0}, "speed 0.0 is outside"),
        ({"id": 1, "to": 1, "speed": math.nan}, "speed nan is outside"),
        ({"id": 1, "to": 1, "speed": 21.0}, "speed 21.0 is outside"),
        ({"id": 1, "rad": 0.5}, "turns no joint"),
        ({"pose": {"l_knee": 0.5}}, "no joint 'l_knee'"),
        ({"id": 9, "to": 1}, "no servo with id 9"),
    ],
)
def test_a_wrong_order_is_refused_and_nothing_moves(order: dict[str, object], words: str) -> None:
    host = Host([1])
    with pytest.raises((ValueError, KeyError)) as refused:
        host.bus.faults.hand(**order)  # type: ignore[arg-type]
    assert words in str(refused.value)
    host.wait(1.0)
    assert host.present(1) == 2048


# ---------------------------------------------------------------------------------------- a robot


def robot(
    physics: bool, name: str = "h24", **joints: JointGroundTruth
) -> tuple[VirtualRobotSpec, dict[str, ServableBus]]:
    made = make_spec(load_robot(name), truth=RobotGroundTruth(joints))
    return made, buses(made, physics=physics)


def angle(made: VirtualRobotSpec, virtual: dict[str, ServableBus], joint: str, now: float) -> float:
    """Return the angle of that joint, rad."""
    place = made.robot.names.index(joint)
    spec = made.wired.joints[place]
    bus = virtual[spec.bus]
    row = [each.name for each in made.joints(spec.bus)].index(joint)
    told = bus.truth(now)[row]
    count = told["encoder"] if bus.kind == "dynamixel2" else told["position"]
    return float((count - made.zeros[joint]) * spec.sign / spec.ratio * math.tau / spec.type.ticks_per_turn)


@pytest.mark.parametrize("physics", [True, False])
@pytest.mark.parametrize("joint", ["l_knee", "l_shoulder_pitch"])
def test_a_hand_holds_a_limb_against_gravity_within_three_ticks(physics: bool, joint: str) -> None:
    made, virtual = robot(physics)
    virtual["main"].faults.hand(pose={joint: 0.7}, speed=1.5)
    for step in range(1, 21):
        virtual["main"].advance(0.1 * step)
    assert angle(made, virtual, joint, 2.0) == pytest.approx(0.7, abs=2.9 / PER_RAD)


@pytest.mark.parametrize("physics", [True, False])
def test_a_hand_ends_at_the_stops_in_both_directions(physics: bool) -> None:
    knee = {"l_knee": JointGroundTruth(stops_rad=(-0.1, 1.3), sign=-1, zero_ticks=4090)}
    made, virtual = robot(physics, **knee)
    faults = virtual["main"].faults
    for end, wish in ((1.3, 3.0), (-0.1, -1.0)):
        faults.hand(pose={"l_knee": wish}, speed=2.0)
        start = virtual["main"].servos.now
        for step in range(1, 31):
            virtual["main"].advance(start + 0.1 * step)
        assert angle(made, virtual, "l_knee", start + 3.0) == pytest.approx(end, abs=2 / PER_RAD)


def test_a_limb_falls_when_the_hand_is_removed() -> None:
    made, virtual = robot(True)
    faults = virtual["main"].faults
    faults.hand(pose={"l_shoulder_pitch": 1.2}, speed=2.0)
    virtual["main"].advance(2.0)
    held = angle(made, virtual, "l_shoulder_pitch", 2.0)
    faults.hand(off=True)
    virtual["main"].advance(4.0)
    assert held == pytest.approx(1.2, abs=0.01)
    assert abs(angle(made, virtual, "l_shoulder_pitch", 4.0)) < 0.6


@pytest.mark.parametrize("physics", [True, False])
def test_a_can_actuator_is_moved_by_a_hand_too(physics: bool) -> None:
    stops = {"l_knee": JointGroundTruth(stops_rad=(-0.1, 1.3))}
    made, virtual = robot(physics, "h24-mixed", **stops)
    leg = virtual["l_leg"]
    id = made.robot.joints[made.robot.names.index("l_knee")].id
    leg.faults.hand(id, rad=0.6, speed=1.0)
    leg.advance(2.0)
    assert angle(made, virtual, "l_knee", 2.0) == pytest.approx(0.6, abs=0.003)
    leg.faults.hand(id, to=made.zeros["l_knee"], speed=1.0)
    leg.advance(4.0)
    assert angle(made, virtual, "l_knee", 4.0) == pytest.approx(0.0, abs=0.003)
    leg.faults.hand(id, rad=3.0, speed=2.0)
    leg.advance(6.0)
    assert angle(made, virtual, "l_knee", 6.0) == pytest.approx(1.3, abs=0.003)


def test_dry_friction_is_in_the_current() -> None:
    """Driven slowly either way a joint needs friction more than without: half of the gap is the friction."""
    gaps = []
    for friction in (0.02, 0.30):
        _, virtual = robot(True, head_yaw=JointGroundTruth(friction_nm=friction))
        servos = virtual["main"].servos
        row = H24.names.index("head_yaw")
        here = int(servos["goal_position"][row])
        servos.torque(row, True)
        servos.invalidate_cache()
        servos.registers.put("profile_velocity", 4, row)
        servos.invalidate_cache()
        currents = []
        now = 0.0
        for goal in (here + 200, here - 200):
            servos.set_goals(np.array([goal]), np.array([row]))
            now += 1.0
            servos.advance(now)
            currents.append(servos.muscles.current[row])
            now += 3.0
            servos.advance(now)
        gaps.append(abs(currents[0] - currents[1]) / 2)
    unit = H24.joints[H24.names.index("head_yaw")].type.effort_lsb_nm
    assert (gaps[1] - gaps[0]) * unit == pytest.approx(0.28, rel=0.15)


def test_backlash_lets_the_encoder_stay_behind_by_half_of_it_on_either_side() -> None:
    made, virtual = robot(False, l_knee=JointGroundTruth(backlash_ticks=10.0))
    bus = virtual["main"]
    seen = []
    for step, rad in enumerate((0.5, 0.7, 0.5), 1):
        bus.faults.hand(pose={"l_knee": rad}, speed=5.0)
        bus.advance(float(step))
        seen.append(angle(made, virtual, "l_knee", float(step)) * PER_RAD)
    up, _, down = seen
    assert abs(up - down) == pytest.approx(10.0, abs=0.5), "the same place, from two sides"


# ---------------------------------------------------------------------------------------- orders


class Port:
    """As much of a port as orders need."""

    present = True
    fd = -1

    def __init__(self, name: str) -> None:
        self.name = self.path = name


def test_a_hand_pose_is_split_among_the_buses_and_off_releases_all() -> None:
    made, virtual = robot(False, "h24-mixed")
    clock = FakeClock()
    ports = {name: Port(name) for name in virtual}
    server = VirtualBusServer(virtual, ports, ServoClock(clock), lambda name, path: None)  # type: ignore[arg-type]
    wish = {"l_knee": 0.5, "r_knee": 0.4, "head_yaw": 0.3}
    assert server.execute_fault_command({"fault": "hand", "pose": wish, "speed": 3.0}) == {"ok": True}
    for bus in virtual.values():
        bus.advance(1.0)
    found = {joint: angle(made, virtual, joint, 1.0) for joint in wish}
    assert found == pytest.approx(wish, abs=0.003)
    server.execute_fault_command({"fault": "hand", "off": True})
    with pytest.raises(InvalidInput, match="no joint 'tail'; there are"):
        server.execute_fault_command({"fault": "hand", "pose": {"l_knee": 0.0, "tail": 1.0}})
    with pytest.raises(InvalidInput, match="no bus None; there are upper"):
        server.execute_fault_command({"fault": "hand", "id": 7, "to": 2000})
    for bus in virtual.values():
        bus.advance(2.0)
    assert {joint: angle(made, virtual, joint, 2.0) for joint in wish} == pytest.approx(wish, abs=0.003)


def test_an_encoder_that_stands_still_within_the_play_shows_no_speed() -> None:
    made, virtual = robot(False, l_knee=JointGroundTruth(backlash_ticks=40.0))
    servos = virtual["main"].servos
    row = made.robot.names.index("l_knee")
    virtual["main"].faults.hand(pose={"l_knee": 0.5}, speed=1.0)
    seen = []
    for step in range(1, 11):
        before = servos.muscles.position[row]
        virtual["main"].advance(0.01 * step)
        seen.append((servos.muscles.position[row] != before, servos.muscles.velocity[row] != 0.0))
    assert (False, False) in seen and (True, True) in seen
    assert all(moved == fast for moved, fast in seen)
    virtual["main"].advance(2.0)
    virtual["main"].advance(2.1)
    assert servos.muscles.velocity[row] == 0.0, "arrived"


def test_a_rotated_base_changes_the_hang_and_an_impossible_rotation_is_refused() -> None:
    made, virtual = robot(True)
    bus = virtual["main"]
    upright = angle(made, virtual, "l_shoulder_pitch", 1.0)
    bus.faults.lay("back")
    bus.advance(4.0)
    assert abs(angle(made, virtual, "l_shoulder_pitch", 4.0) - upright) > 0.5
    with pytest.raises(KeyError, match="no base 'head'; there are upright"):
        bus.faults.lay("head")
    with pytest.raises(ValueError, match="no body"):
        robot(False)[1]["main"].faults.lay("back")
