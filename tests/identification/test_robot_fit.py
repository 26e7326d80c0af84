"""Hidden parameters of a simulated robot are found, and stated no better than they are known."""

import numpy as np
import pytest

from tests.support.hidden_robot import goals_of, hide, record
from twind.config.robot_file import load_robot
from twind.identification.excitation import RATE, ExcitationBounds, excite
from twind.identification.identified_robot import DataOrigin, identify_robot
from twind.identification.robot_fit import identify_joints
from twind.identification.servo_parameters import interval
from twind.twin.simulation import hush

ROBOT = load_robot("pan-tilt")


@pytest.fixture(autouse=True)
def _quiet() -> None:
    hush()


@pytest.mark.slow
def test_the_error_of_the_simulation_falls_below_a_twentieth_of_the_motion() -> None:
    hidden = hide(ROBOT, 0)
    alone = goals_of(hidden.binding, np.zeros(2))[:1800, ::-1]  # pan would be the first
    motion = record(hidden, alone)
    found = identify_joints(hidden.binding, [motion], ["tilt"])["tilt"]
    assert found.after.spread < 0.05
    assert found.after.unexplained < 0.5 * found.before.unexplained
    estimates = found.joint.estimates()
    inside = []
    for name, each in estimates.items():
        low, high = interval(name, each.value, each.sd)
        inside.append(low <= (hidden.truth.joints["tilt"].value(name) or 0.0) <= high)
    assert sum(inside) >= 8
    assert estimates["delay_s"].determined


def test_a_joint_that_does_not_move_is_left_out() -> None:
    hidden = hide(ROBOT, 1)
    goals = np.zeros((600, 2))
    assert identify_joints(hidden.binding, [record(hidden, goals)]) == {}


@pytest.mark.slow
def test_only_joints_that_were_named_are_reported_as_still() -> None:
    hidden = hide(ROBOT, 1)
    goals = np.zeros((1600, 2))
    goals[:, ROBOT.names.index("tilt")] = 0.3 * np.sin(np.arange(1600) * 0.03)
    motions = [record(hidden, goals)]
    origin = DataOrigin("2026-11-29T10:00:00Z", "test", "hidden")
    steps: list[str] = []
    found = identify_robot(
        hidden.binding,
        motions,
        origin,
        lambda _: hidden.binding,
        ["tilt"],
        lambda text, share, seconds=None: steps.append(text),
    )
    assert list(found.model.joints) == ["tilt"]
    assert found.still == []
    assert steps[:1] == ["fits tilt"]
    assert "pan" not in " ".join(steps)


@pytest.mark.parametrize("shift", [0.0, 0.3, 0.7])
@pytest.mark.parametrize("amplitude", [0.2, 0.4])
def test_the_gate_need_not_slow_an_excitation_down(amplitude: float, shift: float) -> None:
    bounds = ExcitationBounds(-2.0, 2.0, 4.0, 20.0)
    goals = excite(0.3, bounds, amplitude, shift)
    speed = np.gradient(goals, 1.0 / RATE)  # as `Robot.follow` gives it
    chord = np.diff(goals) * RATE
    ends = [
        (6.0 * chord - 4.0 * speed[:-1] - 2.0 * speed[1:]),
        (-6.0 * chord + 2.0 * speed[:-1] + 4.0 * speed[1:]),
    ]
    assert max(np.abs(each).max() for each in ends) * RATE <= bounds.acceleration


def test_excitation_keeps_to_its_bounds_and_returns() -> None:
    bounds = ExcitationBounds(-0.8, 0.8, 3.0, 15.0)
    goals = excite(0.7, bounds, 0.6)
    speed = np.diff(goals) * RATE
    assert goals[0] == goals[-1] == 0.7
    assert (np.abs(goals) <= 0.8).all()
    assert np.abs(speed).max() <= 3.0
    assert np.ptp(goals) > 0.8
