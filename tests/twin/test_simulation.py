"""The simulation follows its goals by physics, and recovers from what would break it."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.robot.arrays import Floats
from twind.twin.binding import bind
from twind.twin.simulation import Simulation, hush

ROBOT = load_robot("h24")
BINDING = bind(ROBOT, None)
COUNT = 24
KNEE = ROBOT.names.index("l_knee")
BENT = np.array([ROBOT.poses["stand"][name] for name in ROBOT.names])


@pytest.fixture(autouse=True)
def _quiet() -> None:
    hush()


def run(simulation: Simulation, goal: Floats | None, ticks: int) -> Floats:
    for _ in range(ticks):
        simulation.step(goal)
    return simulation.state(0.0).position


@pytest.mark.parametrize("period", [0.1, 0.01, 0.007, 0.005, 0.001])
def test_a_tick_is_exactly_its_period_of_physics(period: float) -> None:
    simulation = Simulation(BINDING, period)
    for _ in range(5):
        simulation.step(None)
    assert simulation.data.time == pytest.approx(5 * period)
    assert simulation.model.opt.timestep <= BINDING.model.opt.timestep + 1e-12


@pytest.mark.parametrize("period", [0.0, -0.01, 2.0, float("nan")])
def test_a_period_that_is_none_is_refused(period: float) -> None:
    with pytest.raises(ValueError, match="period"):
        Simulation(BINDING, period)


def test_at_rest_nothing_moves() -> None:
    simulation = Simulation(BINDING, 0.01)
    assert np.abs(run(simulation, None, 300)).max() < 2e-3


def test_a_goal_is_reached_by_physics_not_at_once() -> None:
    simulation = Simulation(BINDING, 0.01)
    first = run(simulation, BENT, 1)
    assert 0.0 < first[KNEE] < 0.3 * BENT[KNEE]
    assert np.abs(run(simulation, BENT, 150) - BENT).max() < 0.05
    assert simulation.warnings == 0


def test_without_a_goal_the_last_is_held() -> None:
    simulation = Simulation(BINDING, 0.01)
    run(simulation, BENT, 150)
    assert np.abs(run(simulation, None, 100) - BENT).max() < 0.05


def test_the_state_is_a_fresh_and_read_only_reading() -> None:
    simulation = Simulation(BINDING, 0.01)
    simulation.step(BENT)
    state = simulation.state(12.5)
    assert (state.time, state.round_trip) == (12.5, 0.0)
    assert state.heard.all()
    assert (state.age == 0.0).all()
    assert state.effort[KNEE] > 0.5
    for array in (state.position, state.velocity, state.effort, state.age, state.heard):
        assert not array.flags.writeable
    kept = state.position.copy()
    simulation.step(BENT)
    assert (state.position == kept).all()


def test_a_servo_pulls_no_harder_than_it_can() -> None:
    simulation = Simulation(BINDING, 0.01)
    simulation.step(np.full(COUNT, 2.0))
    assert 4.0 < np.abs(simulation.state(0.0).effort).max() <= 4.1


def test_place_starts_anew_at_rest_and_holds() -> None:
    simulation = Simulation(BINDING, 0.01)
    run(simulation, -BENT, 20)
    simulation.place(BENT)
    state = simulation.state(0.0)
    assert (state.position == BENT).all()
    assert (state.velocity == 0.0).all()
    assert np.abs(run(simulation, None, 100) - BENT).max() < 0.05


def test_placing_a_joint_nowhere_leaves_it() -> None:
    simulation = Simulation(BINDING, 0.01)
    target = BENT.copy()
    target[KNEE], target[KNEE + 1] = np.nan, np.inf
    simulation.place(target)
    position = simulation.state(0.0).position
    assert position[KNEE] == position[KNEE + 1] == 0.0
    assert (np.delete(position, [KNEE, KNEE + 1]) == np.delete(BENT, [KNEE, KNEE + 1])).all()


def test_halt_stops_where_it_is_until_released() -> None:
    simulation = Simulation(BINDING, 0.01)
    run(simulation, BENT, 4)
    simulation.halt()
    stopped = simulation.state(0.0).position
    assert 0.05 < stopped[KNEE] < BENT[KNEE]
    # the way of braking is that of a leg at speed, pulled by a servo
    assert np.abs(run(simulation, BENT, 200) - stopped).max() < 0.06
    simulation.release()
    assert np.abs(run(simulation, BENT, 200) - BENT).max() < 0.05


def test_place_ends_a_halt() -> None:
    simulation = Simulation(BINDING, 0.01)
    simulation.halt()
    simulation.place(BINDING.rest)
    assert run(simulation, BENT, 150)[KNEE] > 0.5


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_a_goal_that_is_no_angle_is_not_taken(bad: float) -> None:
    simulation = Simulation(BINDING, 0.01)
    goal = BENT.copy()
    goal[KNEE] = bad
    position = run(simulation, goal, 150)
    assert abs(position[KNEE]) < 0.05
    assert np.abs(np.delete(position - BENT, KNEE)).max() < 0.05
    assert simulation.warnings == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e20])
def test_physics_that_breaks_down_is_counted_and_put_back_to_the_last_good_pose(bad: float) -> None:
    simulation = Simulation(BINDING, 0.01)
    run(simulation, BENT, 150)
    good = simulation.state(0.0).position
    simulation.data.qvel[3] = bad
    simulation.step(BENT)
    assert simulation.resets == 1
    assert simulation.warnings >= 1
    assert np.abs(simulation.state(0.0).position - good).max() < 1e-6
    assert np.abs(run(simulation, BENT, 50) - BENT).max() < 0.05
    assert simulation.resets == 1


def test_mujoco_writes_no_log_into_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    simulation = Simulation(BINDING, 0.01)
    simulation.data.qpos[3] = np.nan
    simulation.step(None)
    assert simulation.warnings >= 1
    assert list(tmp_path.iterdir()) == []
    assert "WARNING" not in "".join(capfd.readouterr())


def test_a_free_robot_starts_with_its_feet_on_the_floor() -> None:
    binding = bind(replace(ROBOT, support="free"), None)
    for pose in (binding.rest, BENT):
        simulation = Simulation(binding, 0.01)
        simulation.place(pose)
        model = simulation.model
        data = simulation.data
        mujoco.mj_kinematics(model, data)
        floor = model.geom("floor").id
        gaps = [
            mujoco.mj_geomDistance(model, data, floor, model.geom(name).id, 1.0, None)
            for name in ("l_foot", "r_foot", "torso", "l_hand")
        ]
        assert min(gaps) == pytest.approx(0.0, abs=1e-6)
        height = float(data.qpos[2])
        for _ in range(30):
            simulation.step(None)
        assert data.ncon > 0  # stands
        assert abs(float(data.qpos[2]) - height) < 0.01


def test_two_simulations_of_the_same_goals_are_the_same() -> None:
    one = Simulation(BINDING, 0.01)
    other = Simulation(BINDING, 0.01)
    other.place(-BENT)
    other.place(BINDING.rest)
    assert np.array_equal(run(one, BENT, 50), run(other, BENT, 50))


def test_a_pose_that_breaks_down_at_once_is_no_good_one() -> None:
    simulation = Simulation(BINDING, 0.01)
    simulation.place(np.full(len(BINDING.rest), 5.7))  # through itself, and beyond every limit
    simulation.data.qvel[3] = np.nan
    simulation.step(None)
    position = run(simulation, BINDING.rest, 100)
    assert simulation.resets == 1
    assert np.abs(position - BINDING.rest).max() < 0.05
