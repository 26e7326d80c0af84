"""The gait that a policy imitates: a cycle, alike on both sides, within what the robot can."""

import numpy as np
import pytest

pytest.importorskip("mink", reason="the extra walk")

from twind.config.robot_file import load_robot
from twind.learn.task.gait_reference import GaitReference, GaitTeacher
from twind.learn.task.learning_tasks import WALK
from twind.learn.task.plant_model import Plant, plant_of

PERIOD = WALK.shaping.period
FORWARD = np.array([0.15, 0.0, 0.0])


@pytest.fixture(scope="module")
def plant() -> Plant:
    return plant_of(load_robot("h24-standing"), period=PERIOD)


@pytest.fixture(scope="module")
def reference(plant: Plant) -> GaitReference:
    return GaitReference(plant.binding.robot, WALK.stride, PERIOD)


def cycle(reference: GaitReference, command: np.ndarray) -> np.ndarray:
    phases = WALK.phases(PERIOD)
    return reference.positions(phases, np.broadcast_to(command, (len(phases), 3)))


def test_a_command_of_zero_is_the_stance(reference: GaitReference) -> None:
    assert np.array_equal(
        cycle(reference, np.zeros(3)), np.broadcast_to(reference.stance, (len(WALK.phases(PERIOD)), 24))
    )


def test_the_gait_closes_and_never_jumps(reference: GaitReference, plant: Plant) -> None:
    rows = cycle(reference, FORWARD)
    change = np.diff(rows, axis=0, append=rows[:1])
    assert (np.abs(change) / PERIOD <= 1.2 * plant.binding.limits.velocity).all()


def test_the_gait_stays_within_the_limits(reference: GaitReference, plant: Plant) -> None:
    limits = plant.binding.limits
    rows = cycle(reference, FORWARD)
    assert (rows >= limits.lower).all() and (rows <= limits.upper).all()
    assert (np.abs(rows - plant.default) <= WALK.shaping.reach).all()


def test_both_legs_do_the_same_half_a_cycle_apart(reference: GaitReference) -> None:
    names = list(load_robot("h24-standing").names)
    rows = cycle(reference, FORWARD)
    for joint in ("hip_pitch", "knee", "ankle_pitch"):
        left = rows[:, names.index(f"l_{joint}")]
        right = rows[:, names.index(f"r_{joint}")]
        assert np.abs(left - np.roll(right, len(rows) // 2)).max() < 0.02


@pytest.mark.parametrize("ahead", [1, 5])
def test_a_later_phase_is_the_row_that_follows(reference: GaitReference, ahead: int) -> None:
    phases = WALK.phases(PERIOD)
    rows = cycle(reference, FORWARD)
    later = reference.positions(phases[3], FORWARD, ahead)
    assert np.array_equal(later, rows[3 + ahead])


def test_the_teacher_s_ankles_push_against_a_tilt(plant: Plant) -> None:
    teacher = GaitTeacher(WALK, plant)
    places = plant.layout.places
    rows = np.zeros((2, plant.layout.size))
    rows[:, places["phase"]] = WALK.phases(PERIOD)[0]
    rows[:, places["base"]][:, 6:9] = [[0.0, 0.0, -1.0], [0.1, 0.0, -1.0]]  # upright; tilted forward
    ankle = plant.binding.robot.names.index("r_ankle_pitch")
    upright, tilted = teacher.act(rows)[:, ankle]
    assert tilted > upright + 0.01
