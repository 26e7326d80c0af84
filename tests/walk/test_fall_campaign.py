"""Figures of fall detection on h24-standing: how early, how often wrong, and what a reaction is worth.

`pytest -m campaign tests/walk/test_fall_campaign.py -s` prints the tables of docs/safety.md.
"""

from contextlib import closing
from functools import cache
from math import isfinite, radians

import numpy as np
import pytest

from tests.support.fall_rig import STILL, Fall, FallRig
from tests.support.hand_rig import Hands
from twind.config.robot_file import load_robot
from twind.robot.fall_settings import FallReaction
from twind.virtual.robot_ground_truth import random_truth

pytestmark = pytest.mark.campaign

IMPULSES = (1.5, 2.0, 3.0, 4.0, 6.0)  # N·s, over 0.1 s
FORWARD = (0.12, 0.0, 0.0)  # m/s
TURNING = (0.0, 0.0, 0.25)  # rad/s
MILD = (0.5, 1.0)
DIRECTIONS = range(0, 360, 45)  # degrees from forward to the left
SQUAT = {"hip_pitch": -0.9, "knee": 1.8, "ankle_pitch": -0.9}
REACTIONS = (None, *FallReaction)


@cache
def pushed(reaction: FallReaction | None, impulse: float, direction: int) -> Fall:
    with closing(FallRig(reaction)) as rig:
        rig.stand()
        return rig.push(impulse, radians(direction), 2.5)


def all_pushed(reaction: FallReaction | None, impulse: float) -> list[Fall]:
    return [pushed(reaction, impulse, direction) for direction in DIRECTIONS]


def reaction_times(reaction: FallReaction, impulse: float) -> list[float]:
    """Return the s from the detection of each fall until its goals have changed."""
    return [fall.reacted - fall.detected for fall in all_pushed(reaction, impulse) if isfinite(fall.reacted)]


def ordered(values: list[float]) -> str:
    """Least, median and largest."""
    return f"{min(values):.2f} / {np.median(values):.2f} / {max(values):.2f}"


def test_each_fall_is_detected_a_tenth_of_a_second_before_the_ground() -> None:
    print("\nN·s  falls  detected s  before the ground s  then soft s  then fold s: least / median / largest")
    for impulse in IMPULSES:
        falls = [fall for fall in all_pushed(FallReaction.HOLD, impulse) if fall.fell]
        late = [reaction_times(reaction, impulse) for reaction in (FallReaction.SOFT, FallReaction.FOLD)]
        detected = [fall.detected for fall in falls]
        left = [fall.ground - fall.detected for fall in falls]
        print(f"{impulse:g}", len(falls), *map(ordered, (detected, left, *late)), sep="  ")
        assert min(left) > 0.1


def test_no_push_that_the_stance_bears_is_taken_for_a_fall() -> None:
    borne = [pushed(FallReaction.HOLD, impulse, way) for impulse in (*MILD, *IMPULSES) for way in DIRECTIONS]
    borne = [fall for fall in borne if not fall.fell]
    wrong = [fall for fall in borne if isfinite(fall.detected)]
    print(f"\n{len(wrong)} of {len(borne)} pushes that did not end on the ground were taken for a fall")
    assert len(borne) >= len(MILD) * len(DIRECTIONS)
    assert wrong == []


def test_reactions_soften_slow_falls_only() -> None:
    print("\nN·s  reaction  speed m/s  force N  torque through a gear N·m: medians")
    for impulse in IMPULSES:
        by_reaction = {}
        for reaction in REACTIONS:
            falls = [fall for fall in all_pushed(reaction, impulse) if fall.fell]
            figures = [(fall.speed, fall.force, fall.torque) for fall in falls]
            speed, force, torque = np.median(figures, axis=0).tolist()
            by_reaction[reaction] = speed
            print(f"{impulse:g}  {reaction or 'none'}  {speed:.2f}  {force:.0f}  {torque:.1f}")
        assert min(by_reaction.values()) > 0.7 * by_reaction[None]


@pytest.mark.parametrize("seed", range(10))
def test_a_walk_and_a_turn_are_no_fall(seed: int) -> None:
    with closing(FallRig(FallReaction.HOLD, truth=random_truth(load_robot("h24-standing"), seed))) as rig:
        rig.stand()
        for seconds, command in ((30.0, FORWARD), (5.0, STILL), (6.3, TURNING), (5.0, STILL)):
            assert rig.follow(seconds, command)


@pytest.mark.parametrize("seconds", [1.0, 2.0])  # in 0.5 s it truly falls
def test_squats_are_no_fall(seconds: float) -> None:
    with closing(FallRig(FallReaction.HOLD)) as rig:
        rig.stand()
        for _ in range(10):
            assert rig.squat(SQUAT, seconds)


@pytest.mark.parametrize("tilt", [0.1, 0.2, 0.3, 0.5])
@pytest.mark.parametrize("direction", [0, 90, 180])
def test_an_armed_robot_that_is_lifted_is_a_fall_from_a_tilt_of_a_fifth_on(
    tilt: float, direction: int
) -> None:
    with closing(FallRig(FallReaction.HOLD)) as rig:
        rig.stand()
        assert rig.body is not None

        def carry(time: float) -> tuple[float, float, float]:
            share = float(np.clip((time - 0.5) / 1.0, 0.0, 1.0)) * tilt
            way = radians(direction)
            return 0.3 * min(time, 0.5), share * np.cos(way), share * np.sin(way)

        hands: object = Hands(rig.body, "torso", carry)
        rig.body.crane = hands  # type: ignore[assignment]
        rig.follow(3.0)
        print(f"tilt {tilt:g} towards {direction}: {len(rig.trips)} falls")
        assert tilt > 0.2 or not rig.trips
