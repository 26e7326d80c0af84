"""A simulated joint that something holds back does not reach its goal, and the contact is named."""

from pathlib import Path

import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.hull_robot import hull
from twind import link
from twind.config.robot_file import load_robot
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode

HEAD = 0
TAIL = 1
HAND = 3
INSIDE = -1.5  # rad: the hand would be inside the torso
SIMULATED = [Mode.SIM, Mode.MIRROR]


def ready(make_rig: MakeRig, robot: str, mode: Mode) -> Rig:
    rig = make_rig(robot, mode)
    if mode is Mode.LIVE:
        rig.arm()
    else:
        if mode is Mode.MIRROR:
            rig.connect()
        rig.lease()
    return rig


@pytest.fixture(params=SIMULATED)
def simulated(make_rig: MakeRig, request: pytest.FixtureRequest, tmp_path: Path) -> Rig:
    return ready(make_rig, str(hull(tmp_path).path), request.param)


@pytest.fixture
def live(make_rig: MakeRig, tmp_path: Path) -> Rig:
    return ready(make_rig, str(hull(tmp_path).path), Mode.LIVE)


def move(rig: Rig, joint: str, goal: float, **more: object) -> link.Reply:
    """The last report of a motion of 2.5 s, after five seconds more."""
    ticket = rig.submit(rig.path(joint, [goal], [2.5]), more=True, **more)
    rig.seconds(7.5)
    return rig.replies(ticket)[-1]


def test_a_joint_in_an_overlapping_hull_arrives(simulated: Rig) -> None:
    assert move(simulated, "head", 0.5).parameters["phase"] == "succeeded"
    assert simulated.loop.robot.simulated.position[HEAD] == pytest.approx(0.5, abs=0.02)


def test_a_motion_whose_simulation_is_blocked_is_aborted_with_joint_value_bound_and_contact(
    simulated: Rig,
) -> None:
    last = move(simulated, "hand", INSIDE)
    place = simulated.loop.robot.simulated.position[HAND]
    assert place > -1.0
    assert last.parameters["phase"] == "aborted"
    (finding,) = last.parameters["findings"]
    assert (finding["code"], finding["joint"], finding["bound"]) == (ReasonCode.GOAL_TOLERANCE, HAND, 0.2)
    assert finding["value"] == pytest.approx(place - INSIDE, abs=0.05)
    assert 2.5 + 0.5 < finding["time"] < 2.5 + 0.6
    assert "hand and torso touch in the simulation" in finding["message"]
    (told,) = [event for event in simulated.events("MOTION") if "aborted" in event.message]
    assert told.findings[0].message == finding["message"]


def test_after_a_blocked_motion_the_joint_is_held_where_it_is_and_the_next_motion_runs(
    simulated: Rig,
) -> None:
    move(simulated, "hand", INSIDE)
    reference = simulated.loop.executor.reference
    assert reference is not None
    assert reference.position[HAND] == pytest.approx(simulated.loop.robot.simulated.position[HAND], abs=0.05)
    simulated.lease()
    assert move(simulated, "hand", 0.3).parameters["phase"] == "succeeded"


def test_a_goal_tolerance_of_the_client_replaces_the_default(simulated: Rig) -> None:
    wide = move(simulated, "hand", INSIDE, tolerances=[(HAND, None, 2.0)])
    assert wide.parameters["phase"] == "succeeded"
    simulated.lease()
    narrow = move(simulated, "hand", INSIDE, tolerances=[(HAND, None, 0.01)], goal_time=1.0)
    (finding,) = narrow.parameters["findings"]
    assert (finding["code"], finding["bound"]) == (ReasonCode.GOAL_TOLERANCE, 0.01)
    assert 3.5 < finding["time"] < 3.6


def test_a_goal_time_of_the_client_counts_for_the_default_tolerance(simulated: Rig) -> None:
    last = move(simulated, "hand", INSIDE, goal_time=2.0)
    assert 4.5 < last.parameters["findings"][0]["time"] < 4.6


def test_a_tolerance_erased_for_another_joint_lets_no_blocked_motion_wait_without_end(simulated: Rig) -> None:
    last = move(simulated, "hand", INSIDE, tolerances=[(HEAD, None, -1.0)])
    assert last.parameters["phase"] == "aborted"
    (finding,) = last.parameters["findings"]
    assert (finding["code"], finding["joint"], finding["bound"]) == (ReasonCode.GOAL_TOLERANCE, HAND, 0.2)


@pytest.mark.parametrize("mode", SIMULATED)
def test_a_motion_of_a_humanoid_ends_with_its_last_point(make_rig: MakeRig, mode: Mode) -> None:
    """Lag and sag of honest motions are within the tolerance: no tick is added. A raised leg sags most."""
    rig = ready(make_rig, "h24", mode)
    lowest = load_robot("h24").joints[rig.names.index("l_hip_pitch")].lower
    ticket = rig.submit(rig.path("l_hip_pitch", [lowest], [1.5]), more=True)
    rig.seconds(1.45)
    assert [reply.parameters["phase"] for reply in rig.replies(ticket) if not reply.continues] == []
    rig.seconds(0.1)
    assert rig.replies(ticket)[-1].parameters["phase"] == "succeeded"


def test_a_drift_names_the_contact_that_blocks_the_simulated_joint(live: Rig) -> None:
    """The servos of this robot meet nothing: the robot arrives where its model cannot."""
    assert move(live, "hand", INSIDE).parameters["phase"] == "succeeded"
    assert live.loop.robot.measured.position[HAND] == pytest.approx(INSIDE, abs=0.05)
    (finding,) = live.events("MIRROR_DRIFT")[0].findings
    assert finding.joint == HAND
    assert "hand and torso touch in the simulation" in finding.message
    assert "calibration" not in finding.message


def test_a_drift_of_a_joint_that_nothing_blocks_names_no_contact(live: Rig) -> None:
    """The tail's servo is stuck while the hand presses on the torso in the model."""
    live.virtual["main"].faults.lock(2)
    move(live, "hand", INSIDE)
    live.lease()
    move(live, "tail", 0.15)
    messages = {
        finding.joint: finding.message for event in live.events("MIRROR_DRIFT") for finding in event.findings
    }
    assert "touch in the simulation" in messages[HAND]
    assert messages[TAIL].endswith("the simulation of its goals: calibration, load, gains?")


def test_no_motion_of_an_overlapping_hull_drifts(live: Rig) -> None:
    assert move(live, "head", 0.5).parameters["phase"] == "succeeded"
    assert live.events("MIRROR_DRIFT") == []
    assert live.loop.robot.simulated.position[HEAD] == pytest.approx(0.5, abs=0.02)
