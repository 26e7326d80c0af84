"""The twin: mirror and simulation side by side, neither touching the other."""

import numpy as np

from twind.config.robot_file import load_robot
from twind.robot.joint_state import JointState
from twind.twin.binding import bind
from twind.twin.twin import Twin

ROBOT = load_robot("h24")
BINDING = bind(ROBOT, None)
BENT = np.array([ROBOT.poses["stand"][name] for name in ROBOT.names])


def measured(position: float) -> JointState:
    still = np.zeros(24)
    return JointState(1.0, np.full(24, position), still, still, still, np.ones(24, np.bool_))


def test_the_simulated_state_follows_goals_and_the_mirror_follows_readings() -> None:
    twin = Twin(BINDING, 0.01)
    for tick in range(150):
        simulated = twin.update(measured(0.05), BENT, now=tick * 0.01)
    assert np.abs(simulated.position - BENT).max() < 0.05
    assert simulated.time == 1.49
    assert (twin.mirror.position == 0.05).all()
    assert np.isfinite(twin.mirror.effort).all()


def test_without_a_reading_only_the_simulation_moves() -> None:
    twin = Twin(BINDING, 0.01)
    twin.update(None, BENT, now=0.0)
    assert (twin.mirror.position == BINDING.rest).all()
    assert np.isnan(twin.mirror.effort).all()


def test_placing_halting_and_releasing_are_those_of_the_simulation() -> None:
    twin = Twin(BINDING, 0.01)
    twin.place(BENT)
    assert (twin.simulation.state(0.0).position == BENT).all()
    twin.halt()
    assert twin.halted and twin.simulation.frozen
    twin.release()
    assert not twin.halted


def test_non_finite_input_to_mirror_and_simulation_causes_no_warning_and_no_reset() -> None:
    twin = Twin(BINDING, 0.01)
    for bad in (np.nan, np.inf, 1e300):
        twin.update(measured(bad), np.full(24, bad), now=0.0)
    assert (twin.simulation.warnings, twin.resets) == (0, 0)
    assert np.isfinite(twin.mirror.data.xpos).all()
    assert np.isfinite(twin.simulation.data.qpos).all()
