"""A robot of two six-joint legs walks through the gate on virtual servos with a body, and stops at rest."""

import math
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.walking_rig import WalkingRig
from twind.config.robot_file import load_robot
from twind.exceptions import InvalidInput
from twind.robot.modes import Mode
from twind.virtual.robot_ground_truth import random_truth
from twind.walk.walking_engine import WalkingEngine

ROBOT = "h24-standing"
FORWARD = (0.12, 0.0, 0.0)
TURNING = (0.0, 0.0, 0.25)
STILL = (0.0, 0.0, 0.0)


@pytest.fixture
def standing() -> Iterator[WalkingRig]:
    with closing(WalkingRig(ROBOT, Mode.LIVE)) as rig:
        rig.stand()
        yield rig


def heading(rig: WalkingRig) -> float:
    return 2.0 * math.atan2(rig.base[6], rig.base[3])


def test_a_robot_walks_through_the_gate_and_stops_at_rest(standing: WalkingRig) -> None:
    begin = standing.base
    assert standing.walk(6.0, FORWARD)
    assert standing.walk(5.0, STILL)
    assert standing.engine.standing
    assert standing.base[0] - begin[0] > 0.5
    assert abs(standing.base[1] - begin[1]) < 0.05
    assert standing.refusals == []
    assert standing.body is not None
    assert np.abs(standing.body.data.qvel).max() < 0.2


def test_a_command_of_zero_moves_nothing(standing: WalkingRig) -> None:
    begin = standing.base
    assert standing.walk(1.0, STILL)
    assert standing.engine.steps == 0
    assert np.abs(standing.base - begin).max() < 0.01


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(10))
def test_a_robot_of_unknown_friction_and_play_walks_three_metres_turns_and_stands(seed: int) -> None:
    with closing(WalkingRig(ROBOT, Mode.LIVE, truth=random_truth(load_robot(ROBOT), seed))) as rig:
        rig.stand()
        begin = rig.base
        assert rig.walk(30.0, FORWARD)
        assert rig.walk(5.0, STILL)
        way = float(np.hypot(*(rig.base - begin)[:2]))
        print(f"seed {seed}: {way:.2f} m in 35 s, {rig.engine.steps} steps", end=", ")
        assert way >= 3.0
        before = heading(rig)
        assert rig.walk(math.pi / 2 / TURNING[2], TURNING)
        assert rig.walk(5.0, STILL)
        turned = (heading(rig) - before) % (2.0 * math.pi)
        print(f"turned {math.degrees(turned):.0f} degrees, {len(rig.refusals)} refusals")
        assert abs(turned - math.pi / 2) < math.radians(20)
        assert rig.engine.standing
        assert rig.refusals == []


@pytest.mark.parametrize(("robot", "reason"), [("h24", "support"), ("so101", "support")])
def test_a_robot_that_is_held_cannot_walk(robot: str, reason: str) -> None:
    with pytest.raises(InvalidInput, match=reason):
        WalkingEngine(load_robot(robot))


def test_ankles_push_against_a_tilt_whatever_the_sign_of_their_axes(tmp_path: Path) -> None:
    robot = load_robot(ROBOT)
    ankle = 'name="l_ankle_pitch" axis="0 1 0"'
    assert ankle in robot.mjcf
    model = tmp_path / "turned.xml"
    model.write_text(robot.mjcf.replace(ankle, ankle.replace("1", "-1")))
    poses = {name: {**pose, "l_ankle_pitch": -pose["l_ankle_pitch"]} for name, pose in robot.poses.items()}
    turned = replace(robot, mjcf_path=model, poses=poses)
    tilted = np.array([math.cos(0.05), 0.0, math.sin(0.05), 0.0])
    row = robot.names.index("l_ankle_pitch")
    pushes = []
    for each in (robot, turned):
        engine = WalkingEngine(each)
        still = engine.advance(0.01, np.zeros(3))[row]
        pushes.append(engine.advance(0.01, np.zeros(3), tilted, np.zeros(3))[row] - still)
    assert pushes[0] == pytest.approx(-pushes[1], abs=1e-4) and pushes[0] > 0.01


def test_a_robot_that_stands_on_no_feet_is_refused_with_one_that_does() -> None:
    with pytest.raises(InvalidInput, match="two feet, as h24-standing; 0 found"):
        WalkingEngine(load_robot("h24"))
