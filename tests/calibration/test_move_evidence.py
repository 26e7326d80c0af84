"""Evidence of a small move, and its limits: a daemon on servos that MuJoCo moves, under a fake clock."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.move_evidence_rig import FRICTION, stays_of
from tests.support.mujoco_servo_rig import H24, WAY, armed, built
from twind.config.robot_spec import JointSpec
from twind_calibration.wiggling.move_evidence import (
    EncoderObservation,
    EncoderResponse,
    TorqueResponse,
    alike,
    answer,
    came_back,
    weigh,
)
from twind_calibration.wiggling.posed_model import PosedModel
from twind_calibration.wiggling.state_trace import MoveHolds, StateTrace

BODY = PosedModel(H24)
BENT = {"l_hip_pitch": -1.0, "r_hip_pitch": -1.0}  # both legs forward: the waist carries them
Change = Callable[[JointSpec], JointSpec]


def judged(stays: MoveHolds, name: str) -> tuple[EncoderObservation, TorqueResponse]:
    place = H24.names.index(name)
    pose = stays.out.position
    load = weigh(
        float(stays.out.effort[place] + stays.home.effort[place]) / 2.0,
        float(BODY.torque(pose)[place]),
        BODY.turned_round(pose, place),
        FRICTION,
    )
    return answer(stays, place, WAY), load.load


# ------------------------------------------------------------------------------------- a robot


@pytest.mark.slow
def test_a_joint_that_is_right_follows_and_its_load_agrees_where_the_pose_shows_it() -> None:
    with armed(H24, BENT) as rig:
        seen, load = judged(rig.wiggled("waist_pitch"), "waist_pitch")
        assert (seen.motion, seen.others, load) == (EncoderResponse.FOLLOWS, (), TorqueResponse.AGREES)
        assert came_back(seen)
        seen, load = judged(rig.wiggled("head_pitch"), "head_pitch")
        assert (seen.motion, load) == (EncoderResponse.FOLLOWS, TorqueResponse.UNOBSERVABLE)
        rig.virtual["main"].faults.lock(id=6)
        seen, _ = judged(rig.wiggled("l_elbow"), "l_elbow")
        assert (seen.motion, seen.others) == (EncoderResponse.STILL, ())


@pytest.mark.slow
def test_a_reversed_joint_follows_its_goal_and_is_detected_by_load_only() -> None:
    """Goal and reading share the sign, so no encoder can tell; what hangs feels the same either way."""
    with armed(built("waist_pitch", sign=-1)) as rig:
        seen, load = judged(rig.wiggled("waist_pitch"), "waist_pitch")
        assert (seen.motion, load) == (
            EncoderResponse.FOLLOWS,
            TorqueResponse.UNOBSERVABLE,
        )  # and never AGREES
        rig.lease()
        rig.go(BENT, 1.5)
        seen, load = judged(rig.wiggled("waist_pitch"), "waist_pitch")
        assert (seen.motion, load) == (EncoderResponse.FOLLOWS, TorqueResponse.REVERSED)


def test_exchanged_servos_follow_their_goals_and_are_detected_by_the_load_of_a_bent_leg() -> None:
    """Left and right hip: each servo has the other's place, and so moves the other leg."""
    other = {"l_hip_pitch": ("r_hip_pitch", -1), "r_hip_pitch": ("l_hip_pitch", 1)}
    joints = [
        replace(joint, model_joint=other[joint.name][0], sign=other[joint.name][1])
        if joint.name in other
        else joint
        for joint in H24.joints
    ]
    left = H24.names.index("l_hip_pitch")
    right = H24.names.index("r_hip_pitch")
    with armed(replace(H24, joints=tuple(joints)), {"l_knee": 1.8, "l_hip_pitch": -0.5}) as rig:
        stays = rig.wiggled("l_hip_pitch")
    assert answer(stays, left, WAY).motion is EncoderResponse.FOLLOWS
    pose = stays.out.position
    measured = float(stays.out.effort[left])
    model = float(BODY.torque(pose)[left])
    twins = BODY.twins(left)
    found = alike(measured, model, [BODY.load_if_exchanged(pose, left, each) for each in twins], FRICTION)
    assert right in [twins[each] for each in found], (measured, model)


def test_another_gear_ratio_is_not_seen_by_the_encoder() -> None:
    with armed(built("l_elbow", ratio=0.9)) as rig:
        seen, _ = judged(rig.wiggled("l_elbow"), "l_elbow")
    assert seen.motion is EncoderResponse.FOLLOWS


# ------------------------------------------------------------------------------------- the numbers


@pytest.mark.parametrize(
    ("share", "motion"),
    [
        (1.0, EncoderResponse.FOLLOWS),
        (0.71, EncoderResponse.FOLLOWS),
        (0.69, EncoderResponse.SHORT),
        (0.21, EncoderResponse.SHORT),
        (0.19, EncoderResponse.STILL),
        (-0.19, EncoderResponse.STILL),
        (-0.21, EncoderResponse.BACKWARDS),
        (1.29, EncoderResponse.FOLLOWS),
        (1.31, EncoderResponse.FAR),
    ],
)
@pytest.mark.parametrize("way", [WAY, -WAY])
def test_how_far_it_went_beside_its_twin(share: float, motion: EncoderResponse, way: float) -> None:
    assert answer(stays_of({0: share * way}, way), 0, way).motion is motion


def test_a_twin_that_gives_way_is_what_the_joint_is_compared_with() -> None:
    assert answer(stays_of({0: 0.6 * WAY}, 0.6 * WAY), 0, WAY).motion is EncoderResponse.FOLLOWS
    assert (
        answer(stays_of({0: 0.2 * WAY}, 0.2 * WAY), 0, WAY).motion is EncoderResponse.SHORT
    )  # no measure any more
    assert answer(stays_of({0: WAY}, np.nan), 0, WAY).motion is EncoderResponse.FOLLOWS


def test_another_joint_that_moves_is_named_with_how_far() -> None:
    seen = answer(stays_of({0: WAY, 2: 0.5 * WAY}), 0, WAY)
    assert (seen.motion, seen.others, seen.ways) == (EncoderResponse.FOLLOWS, (2,), (0.5 * WAY,))
    instead = answer(stays_of({2: WAY}), 0, WAY)
    assert (instead.motion, instead.others) == (EncoderResponse.STILL, (2,))


def test_a_missing_reading_counts_as_no_motion() -> None:
    assert answer(None, 0, WAY).motion is EncoderResponse.UNHEARD
    assert answer(stays_of({0: np.nan}), 0, WAY).motion is EncoderResponse.UNHEARD
    assert answer(stays_of({0: WAY, 1: np.nan}), 0, WAY).others == ()
    assert came_back(answer(stays_of({0: WAY}, off=0.01), 0, WAY))
    assert not came_back(answer(stays_of({0: WAY}, off=0.02), 0, WAY))


FORCES = st.floats(-5.0, 5.0)


@given(FORCES, FORCES, FORCES, st.floats(0.0, 1.0))
def test_both_signs_are_judged_alike_and_only_where_they_differ(
    a: float, b: float, c: float, friction: float
) -> None:
    load = weigh(a, b, c, friction).load
    mirrored = {
        TorqueResponse.AGREES: TorqueResponse.REVERSED,
        TorqueResponse.REVERSED: TorqueResponse.AGREES,
    }
    assert weigh(a, c, b, friction).load is mirrored.get(load, load)
    if abs(b - c) <= 2.0 * max(friction, 0.4 * max(abs(b), abs(c))):
        assert load in (TorqueResponse.UNOBSERVABLE, TorqueResponse.NEITHER)
    else:
        assert load is not TorqueResponse.UNOBSERVABLE
    if load is TorqueResponse.AGREES:
        assert abs(a - b) < abs(a - c)


@pytest.mark.parametrize("place", range(3))
def test_a_nan_load_gives_an_unknown_response(place: int) -> None:
    numbers = [1.0, 1.0, -1.0]
    numbers[place] = np.nan
    assert weigh(*numbers, FRICTION).load is TorqueResponse.UNKNOWN


def test_a_load_that_fits_neither_sign_is_not_taken_for_one() -> None:
    assert weigh(4.0, 1.0, -1.0, FRICTION).load is TorqueResponse.NEITHER
    assert weigh(0.0, 1.0, -1.0, FRICTION).load is TorqueResponse.NEITHER
    assert (
        weigh(0.3, 1.0, 1.0, FRICTION).load is TorqueResponse.NEITHER
    )  # a third of it: another gear, or no motor
    assert weigh(0.7, 1.0, 1.0, FRICTION).load is TorqueResponse.UNOBSERVABLE
    assert (
        weigh(-0.91, -0.65, -0.97, FRICTION).load is TorqueResponse.UNOBSERVABLE
    )  # 1.4 times -0.65 is no proof of -0.97


def test_a_servo_that_measures_anothers_load_names_it() -> None:
    assert alike(1.0, 0.1, [0.2, 1.05, np.nan, -1.0], FRICTION) == (1,)
    assert alike(0.15, 0.1, [0.2, 1.05], FRICTION) == ()  # its own fits
    assert alike(0.1, 1.0, [0.1, 0.0], FRICTION) == ()  # as little as many measure


# ------------------------------------------------------------------------------------- the trace


def row(position: float | None, goal: float | None, fresh: bool = True) -> list[dict[str, Any]]:
    return [
        {"name": "a", "position": position, "simulated": 0.0, "effort": 1.0, "goal": goal, "heard": fresh}
    ]


def test_stays_are_separated_by_the_goal_and_a_missing_reading_is_skipped() -> None:
    trace = StateTrace(["a"])
    for place, goal in [(0.0, 0.0)] * 5 + [(0.5, 0.5)] + [(1.0, 1.0)] * 5 + [(0.5, 0.5)] + [(0.1, 0.0)] * 5:
        trace.take(row(place, goal))
    trace.rows[9] = (np.array([np.nan]), *trace.rows[9][1:])
    stays = trace.stays(0, 0.0, 1.0)
    assert stays is not None
    places = [stay.position[0] for stay in (stays.before, stays.out, stays.home)]
    assert places == pytest.approx([0.0, 1.0, 0.1])


def test_a_move_that_did_not_come_to_its_end_has_no_stays() -> None:
    trace = StateTrace(["a"])
    assert trace.stays(0, 0.0, 1.0) is None
    for goal in (0.0, 0.0, 0.5, 0.5):
        trace.take(row(goal, goal))
    assert trace.stays(0, 0.0, 1.0) is None
    trace.take(row(1.0, 1.0))
    assert trace.stays(0, 0.0, 1.0) is None  # not home again
    trace.take(row(None, 0.0, fresh=False))
    stays = trace.stays(0, 0.0, 1.0)
    assert stays is not None and np.isnan(stays.home.position[0])


# ------------------------------------------------------------------------------------- the model


@pytest.mark.parametrize(
    ("name", "way", "seen"),
    [
        ("l_knee", 0.1, "l_foot moves backward"),
        ("l_hip_pitch", -0.1, "l_foot moves forward"),
        ("l_shoulder_roll", 0.1, "l_forearm moves to its left"),
        ("r_shoulder_roll", -0.1, "r_forearm moves to its right"),
        ("head_yaw", 0.1, "turns anti-clockwise seen from above"),
        ("head_yaw", -0.1, "turns clockwise seen from above"),
    ],
)
def test_the_expected_motion_is_described_by_body_and_direction(name: str, way: float, seen: str) -> None:
    assert BODY.looks_like(np.zeros(len(H24.names)), H24.names.index(name), way).endswith(seen)


def test_a_hanging_limb_feels_the_same_with_the_other_sign_and_a_leaning_one_does_not() -> None:
    """A torque that is odd in the angle and a reading that is flipped cancel."""
    pose = np.zeros(len(H24.names))
    knee = H24.names.index("l_knee")
    pose[knee] = 0.8
    assert BODY.turned_round(pose, knee) == pytest.approx(float(BODY.torque(pose)[knee]), abs=0.03)
    pose[H24.names.index("l_hip_pitch")] = -1.4
    assert abs(BODY.turned_round(pose, knee) - float(BODY.torque(pose)[knee])) > 2 * FRICTION


def test_exchanged_servos_measure_each_others_load() -> None:
    """l_hip_pitch (sign +) and r_hip_pitch (sign -), by the counts of their servos."""
    left = H24.names.index("l_hip_pitch")
    right = H24.names.index("r_hip_pitch")
    assert right in BODY.twins(left) and left not in BODY.twins(left)
    true = np.zeros(len(H24.names))
    true[left], true[right] = -0.2, -1.2
    counts = {
        "left": H24.joints[left].sign * -0.2,
        "right": H24.joints[right].sign * -1.2,
    }  # of who sits there
    torque = BODY.torque(true)
    believed = true.copy()
    believed[left] = H24.joints[left].sign * counts["right"]  # the left joint's servo sits at the right hip
    believed[right] = H24.joints[right].sign * counts["left"]
    measured = H24.joints[left].sign * H24.joints[right].sign * float(torque[right])
    assert BODY.load_if_exchanged(believed, left, right) == pytest.approx(measured)


def test_a_leg_on_the_ground_gets_no_load_check() -> None:
    knee = H24.names.index("l_knee")
    elbow = H24.names.index("l_elbow")
    assert not BODY.stands_on(knee)
    free = PosedModel(replace(H24, support="free"))
    assert free.stands_on(knee) and not free.stands_on(elbow)
