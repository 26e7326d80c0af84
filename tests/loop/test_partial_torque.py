"""Some joints armed and the others limp: real bytes under a fake clock, virtual hands on the limp joints."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import transmission_robot_file
from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.robot.arrays import Floats
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.trajectory import Trajectory

LEFT_ARM = ["l_shoulder_pitch", "l_shoulder_roll", "l_shoulder_yaw", "l_elbow"]


def arm(rig: Rig, limp: list[str], **options: Any) -> link.Reply:
    """The reply to an arming of all joints but `limp`."""
    rig.connect()
    rig.lease()
    held = [place for place, name in enumerate(rig.names) if name not in limp]
    return rig.call(link.Arm, joints=held, **options)


def places(rig: Rig, names: list[str]) -> list[int]:
    return [rig.names.index(name) for name in names]


def hand(rig: Rig, pose: dict[str, float]) -> None:
    """Hold joints there by a hand, whatever bus they are on."""
    for joint in rig.robot.joints:
        if joint.name in pose:
            rig.virtual[joint.bus].faults.hand(pose={joint.name: pose[joint.name]}, speed=3.0)


def commanded(rig: Rig) -> Floats:
    reference = rig.loop.executor.reference
    assert reference is not None
    position: Floats = reference.position
    return position


def codes(reply: link.Reply) -> list[tuple[str, int]]:
    assert reply.error == "Refused", reply
    return [(finding["code"], finding["joint"]) for finding in reply.parameters["findings"]]


@pytest.mark.parametrize("robot", ["h24", "so101", pytest.param("h24-mixed", marks=pytest.mark.slow)])
def test_the_chosen_joints_get_torque_move_and_are_lowered_while_one_stays_limp(
    robot: str, make_rig: MakeRig
) -> None:
    rig = make_rig(robot, support="gantry")
    limp = next(
        name
        for place, name in enumerate(rig.names)
        if not any(place in group for group in rig.loop.robot.joints.transmission_groups)
    )
    reply = arm(rig, [limp])
    assert reply.error is None, reply
    others = [place for place, name in enumerate(rig.names) if name != limp]
    assert reply.parameters["joints"] == others
    rig.seconds(1.0)
    torque = rig.loop.hardware.slow.torque
    assert (torque[others] == 1).all() and torque[rig.names.index(limp)] == 0
    moved = rig.names[others[-1]]
    rig.lease()
    there = float(rig.truth[others[-1]] + 0.1 * np.sign(rig.loop.robot.limits.upper[others[-1]]))
    ticket = rig.submit(rig.path(moved, [there], [1.5]), more=True)
    rig.seconds(2.0)
    assert rig.replies(ticket)[-1].parameters.get("phase") == "succeeded", rig.replies(ticket)
    assert rig.loop.condition.state is RobotState.ARMED
    assert rig.call(link.Disarm, ticks=800).error is None
    assert (rig.loop.hardware.slow.torque == 0).all() and not rig.loop.torque.partial
    unwatched = "DEVICE_MISMATCH"  # its joints have no watchdog, which arming says
    assert {event.code for event in rig.events() if event.level in ("warning", "error")} <= {unwatched}


def test_hands_move_a_limp_arm_while_the_rest_moves_and_its_commanded_position_follows(
    make_rig: MakeRig,
) -> None:
    rig = make_rig("h24", support="gantry")
    assert arm(rig, LEFT_ARM).error is None
    rig.virtual["main"].faults.hand(pose={"l_shoulder_pitch": -0.8, "l_elbow": -1.0}, speed=3.0)
    ticket = rig.submit(rig.path("r_elbow", [-0.6], [1.5]), more=True)
    rig.seconds(2.0)
    assert rig.replies(ticket)[-1].parameters["phase"] == "succeeded"
    row = places(rig, LEFT_ARM)
    assert rig.truth[[row[0], row[3]]] == pytest.approx([-0.8, -1.0], abs=0.05)
    assert commanded(rig)[row] == pytest.approx(rig.truth[row], abs=0.02)
    assert rig.loop.condition.state is RobotState.ARMED and not rig.loop.condition.latches


def test_commands_to_a_limp_joint_are_refused_by_name(make_rig: MakeRig) -> None:
    rig = make_rig("h24", support="gantry")
    assert arm(rig, LEFT_ARM).error is None
    elbow = rig.names.index("l_elbow")
    ticket = rig.submit(rig.path("l_elbow", [-0.5], [2.0]))
    rig.ticks(5)
    assert codes(rig.replies(ticket)[-1]) == [("JOINT_LIMP", elbow)]
    setpoint = {"joints": [elbow], "positions": [-0.1], "valid_for": 0.1, "allow_clamp": False}
    assert codes(rig.call(link.Setpoint, velocities=None, **setpoint)) == [("JOINT_LIMP", elbow)]


@pytest.mark.parametrize(
    ("robot", "limp", "end"),
    [
        ("h24", "l_elbow", "hard_upper"),
        ("so101", "gripper", "hard_upper"),
        ("so101", "gripper", "hard_lower"),
        pytest.param("h24-mixed", "l_knee", "hard_upper", marks=pytest.mark.slow),
    ],
)
def test_a_limp_joint_that_a_hand_takes_past_its_stop_is_no_fault_and_the_others_are_lowered(
    robot: str, limp: str, end: str, make_rig: MakeRig
) -> None:
    rig = make_rig(robot, support="gantry")
    assert arm(rig, [limp]).error is None
    place = rig.names.index(limp)
    stop = float(getattr(rig.loop.robot.limits, end)[place])
    beyond = stop + 0.05 * np.sign(stop - float(rig.loop.robot.limits.lower[place]) - 1e-6)
    hand(rig, {limp: beyond})
    rig.seconds(2.0)
    assert rig.loop.condition.state is RobotState.ARMED and not rig.loop.condition.latches
    assert rig.truth[place] == pytest.approx(beyond, abs=0.01)
    assert rig.call(link.Disarm, ticks=1500).error is None
    assert (rig.loop.hardware.slow.torque == 0).all()
    others = np.arange(len(rig.names)) != place
    assert rig.loop.robot.written is not None
    assert np.abs(rig.loop.robot.written - rig.loop.robot.rest)[others].max() < 0.02
    assert not [event for event in rig.events() if event.level == "error"]


@pytest.mark.parametrize("robot", ["h24-split", pytest.param("h24-mixed", marks=pytest.mark.slow)])
def test_all_joints_of_a_bus_may_be_limp(robot: str, make_rig: MakeRig) -> None:
    for number in range(2):
        rig = make_rig(robot, support="gantry")
        limp = [rig.names[place] for place in rig.loop.robot.joints.buses[number].joints]
        assert arm(rig, limp).error is None
        rig.seconds(0.5)
        assert set(np.flatnonzero(rig.loop.hardware.slow.torque == 0)) == set(places(rig, limp))
        assert rig.call(link.Disarm, ticks=1500).error is None


def test_after_a_daemon_that_died_the_joints_with_torque_are_lowered_whatever_the_limp_ones_do(
    make_rig: MakeRig,
) -> None:
    rig = make_rig("h24", support="free")
    assert arm(rig, LEFT_ARM).error is None
    ticket = rig.submit(rig.path("r_elbow", [-0.6], [1.5]), more=True)
    rig.seconds(2.0)
    assert rig.replies(ticket)[-1].parameters["phase"] == "succeeded"
    hand(rig, {"l_elbow": float(rig.loop.robot.limits.hard_upper[rig.names.index("l_elbow")]) + 0.05})
    rig.seconds(0.5)
    rig.loop = rig.born(Mode.LIVE)
    rig.connect()
    assert rig.call(link.Disarm, ticks=1500).error is None
    assert not rig.register("torque_enable").any()
    assert rig.truth[rig.names.index("r_elbow")] == pytest.approx(0.0, abs=0.02)
    assert not rig.events("damp")


def test_a_lost_robot_that_comes_back_has_no_limp_joints_left(make_rig: MakeRig) -> None:
    rig = make_rig("h24", support="gantry")
    assert arm(rig, LEFT_ARM).error is None
    rig.loop.hardware.give_up(0, "ordered by the test")
    rig.seconds(1.0)
    assert not rig.loop.torque.partial


def test_a_hand_that_swings_a_limp_joint_without_watchdog_slows_no_motion_of_the_others(
    make_rig: MakeRig,
) -> None:
    taken = {}
    for swing in (0.0, 0.8):
        rig = make_rig("so101", support="fixed")
        assert arm(rig, ["gripper"]).error is None
        ticket = rig.submit(rig.path("shoulder_pan", [0.5], [1.0]), more=True)
        tick = 0
        while rig.replies(ticket)[-1:] == [] or rig.replies(ticket)[-1].continues:
            hand(rig, {"gripper": 0.8 + swing * np.sin(0.15 * tick)})
            rig.ticks(1)
            tick += 1
            if tick % 50 == 0:
                rig.lease()
        assert rig.replies(ticket)[-1].parameters["phase"] == "succeeded"
        taken[swing] = tick
    assert taken[0.8] <= taken[0.0] + 2


def test_a_motion_stops_before_a_limp_arm_that_a_hand_holds_in_its_way(make_rig: MakeRig) -> None:
    """The path was clear when it was accepted: without the hand it is followed to its end."""
    said = {}
    for hand in (False, True):
        rig = make_rig("h24", support="gantry")
        assert arm(rig, LEFT_ARM).error is None
        inward = {"r_shoulder_pitch": -0.9, "r_shoulder_yaw": 1.4, "r_elbow": -1.4}
        row = places(rig, list(inward))
        goal = commanded(rig).copy()
        goal[row] = list(inward.values())
        named = np.isin(np.arange(len(goal)), row)
        across = {"l_shoulder_pitch": -0.9, "l_shoulder_yaw": -1.4, "l_elbow": -1.4}
        ticket = rig.submit(Trajectory(np.array([4.0]), goal[None], named), more=True)
        if hand:
            rig.virtual["main"].faults.hand(pose=across, speed=3.0)
        for _ in range(9):
            rig.seconds(0.5)
            rig.lease()
        said[hand] = rig.replies(ticket)[-1].parameters
    assert said[False]["phase"] == "succeeded", said
    assert said[True]["phase"] == "aborted"
    assert {finding["code"] for finding in said[True]["findings"]} == {"LOOKAHEAD_COLLISION"}


def test_torque_that_another_program_switches_on_in_a_limp_joint_is_a_fault(make_rig: MakeRig) -> None:
    rig = make_rig("h24", support="gantry")
    assert arm(rig, LEFT_ARM).error is None
    rig.seconds(0.5)
    elbow = rig.names.index("l_elbow")
    rig.virtual["main"].servos.torque(elbow, True)
    rig.seconds(0.5)
    (event,) = rig.events("TORQUE_MISMATCH")
    assert event.findings[0].joint == elbow and event.findings[0].bound == 0.0
    assert rig.loop.condition.state is RobotState.FAULT


@pytest.mark.parametrize("level", ["settle", "cut"])
def test_an_estop_ends_the_torque_of_the_others_and_forgets_which_were_limp(
    level: str, make_rig: MakeRig
) -> None:
    rig = make_rig("h24", support="gantry")
    assert arm(rig, LEFT_ARM).error is None
    rig.call(link.EStop, level=level, ticks=800)
    rig.seconds(6.0)
    assert (rig.register("torque_enable") == 0).all()
    assert rig.call(link.Reset).error is None
    rig.lease()
    assert rig.call(link.Arm).error is None
    assert (rig.register("torque_enable") == 1).all()


def test_a_hand_that_never_rests_does_not_keep_a_robot_from_being_lowered(make_rig: MakeRig) -> None:
    rig = make_rig("h24", support="gantry")
    assert arm(rig, LEFT_ARM).error is None
    ticket = rig.send(link.Disarm)
    for tick in range(800):
        rig.virtual["main"].faults.hand(pose={"l_elbow": -0.8 + 0.4 * np.sin(0.05 * tick)}, speed=3.0)
        rig.ticks(1)
    assert rig.replies(ticket)[-1].error is None
    assert not rig.events("settle") and (rig.register("torque_enable") == 0).all()


def test_a_standing_robot_keeps_its_legs_and_an_arm_may_be_limp(make_rig: MakeRig) -> None:
    rig = make_rig("h24", support="free")
    assert codes(arm(rig, ["l_knee"])) == [("JOINT_LIMP", rig.names.index("l_knee"))]
    assert not rig.register("torque_enable").any()
    assert rig.loop.condition.state is RobotState.CONNECTED
    assert arm(rig, LEFT_ARM).error is None


def test_joints_that_share_motors_are_limp_together_or_not_at_all(make_rig: MakeRig, tmp_path: Path) -> None:
    rig = make_rig(str(transmission_robot_file.write(tmp_path)), support="gantry")
    group = rig.loop.robot.joints.transmission_groups[0].tolist()
    assert codes(arm(rig, [rig.names[group[0]]])) == [("JOINT_LIMP", group[0])]
    assert arm(rig, [rig.names[place] for place in group]).error is None


def test_torque_found_on_in_a_joint_that_is_to_be_limp_prevents_arming(make_rig: MakeRig) -> None:
    rig = make_rig("h24", support="gantry")
    rig.virtual["main"].servos.torque(rig.names.index("l_elbow"), True)
    assert codes(arm(rig, LEFT_ARM))[0][0] in ("ARM_FAILED", "TORQUE_MISMATCH")
    assert rig.register("torque_enable").sum() == 1


def test_a_failed_arming_leaves_no_joint_marked_as_limp(make_rig: MakeRig) -> None:
    rig = make_rig("h24", support="gantry")
    rig.connect()
    rig.virtual["main"].faults.silence(5)
    assert arm(rig, LEFT_ARM).error == "Refused"
    assert not rig.loop.torque.partial
    assert rig.loop.executor.motion is Motion.IDLE


def test_a_joint_that_was_limp_when_every_bus_was_lost_stays_where_it_is_once_it_is_armed(
    make_rig: MakeRig,
) -> None:
    rig = make_rig("h24", support="gantry")
    assert arm(rig, LEFT_ARM).error is None
    hand(rig, {"l_elbow": -1.0})
    rig.seconds(1.0)
    rig.loop.hardware.give_up(0, "ordered by the test")
    rig.seconds(1.0)
    hand(rig, {"l_elbow": -0.2})
    rig.seconds(2.0)
    rig.virtual["main"].faults.hand(off=True)
    assert rig.call(link.Disarm, ticks=1500).error is None
    assert rig.call(link.Reset).error is None
    rig.lease()
    before = rig.truth.copy()
    reply = rig.call(link.Arm)
    assert reply.error is None, reply
    rig.lease()
    rig.seconds(1.0)
    assert np.abs(rig.truth - before).max() < 0.01
