"""An identified model acts alike in the binding, the simulation, the learner's plant and the virtual body."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from twind.config.hot_changes import applied
from twind.config.identified_spec import (
    IdentifiedBody,
    IdentifiedJoint,
    IdentifiedModel,
    ParameterEstimate,
    PositionEstimate,
)
from twind.config.robot_file import RobotFile, load_robot
from twind.exceptions import InvalidInput
from twind.learn.task.plant_model import plant_of
from twind.robot.arrays import Floats
from twind.twin.binding import Binding, bind, rebound
from twind.twin.mujoco_physics import body_of
from twind.twin.servo_effects import DelayedGoals, servo_rows
from twind.twin.simulation import Simulation, hush

ROBOT = load_robot("h24")
PLAIN = bind(ROBOT, None)
KNEE = ROBOT.names.index("l_knee")
PERIOD = 0.01
STAND = np.array([ROBOT.poses["stand"][name] for name in ROBOT.names])


@pytest.fixture(autouse=True)
def _quiet() -> None:
    hush()


def identified(bodies: dict[str, IdentifiedBody] | None = None, **values: float) -> RobotFile:
    """Return h24 with these parameters of the left knee."""
    estimates = {name: ParameterEstimate(value, 0.0, 38.0, 0.0) for name, value in values.items()}
    joints = {"l_knee": IdentifiedJoint(**estimates)}
    model = IdentifiedModel("h24", "2026-11-28T10:00:00Z", "test", "test", 1.0, 0.25, joints, bodies or {})
    return replace(ROBOT, identified=model)


def at_gain(robot: RobotFile, p: int) -> RobotFile:
    """Return the robot with another P gain of its knee's servo type."""
    return applied(robot, {f"types.{robot.joints[KNEE].type.name}.gains": {"p": p, "i": 0, "d": 0}})


def identified_at_gain(**values: float) -> RobotFile:
    """Return h24 with these parameters of the left knee, identified at the P gain 800 that it has."""
    robot = identified(**values)
    assert robot.identified is not None
    joint = replace(robot.identified.joints["l_knee"], p_gain=800.0)
    return at_gain(replace(robot, identified=replace(robot.identified, joints={"l_knee": joint})), 800)


def knee_path(binding: Binding, goal: float, ticks: int, start: Floats = STAND) -> Floats:
    """Return the readings (ticks,) of the left knee after a step of its goal, rad."""
    simulation = Simulation(binding, PERIOD)
    simulation.place(start)
    goals = start.copy()
    goals[KNEE] = goal
    seen = []
    for _ in range(ticks):
        simulation.step(goals)
        seen.append(simulation.state(0.0).position[KNEE])
    return np.array(seen)


def test_static_parameters_stand_in_the_model_of_all_users() -> None:
    robot = identified(
        stiffness_nm_per_rad=30.0, damping_nm_s_per_rad=0.5, friction_nm=0.3, armature_kg_m2=0.02
    )
    binding = bind(robot, None)
    dof = binding.dof[KNEE]
    servo = binding.actuators[KNEE]
    plant = plant_of(robot, period=0.02)
    body = body_of(robot, dict.fromkeys(robot.names, 2048))
    assert binding.model.actuator_gainprm[servo, 0] == 30.0
    assert binding.model.actuator_biasprm[servo, 1:3] == pytest.approx([-30.0, -0.42])
    assert binding.model.dof_damping[dof] == pytest.approx(0.08)
    assert binding.model.dof_frictionloss[dof] == pytest.approx(0.3)
    assert binding.model.dof_armature[dof] == pytest.approx(0.02)
    joint = plant.model.joint("l_knee")
    assert plant.model.dof_frictionloss[joint.dofadr[0]] == pytest.approx(0.3)
    assert body.model.dof_frictionloss[body.model.joint("l_knee").dofadr[0]] == pytest.approx(0.3)
    assert 'frictionloss="0.3"' in binding.mjcf


def test_an_identified_stiffness_follows_the_p_gain_for_all_users_and_a_reload_is_a_restart() -> None:
    robot = identified_at_gain(stiffness_nm_per_rad=30.0)
    soft = at_gain(robot, 400)
    started = bind(soft, None)
    reloaded = rebound(bind(robot, None), soft, None)
    servo = started.actuators[KNEE]
    limit = bind(robot, None).model.actuator_forcerange[servo]
    assert plant_of(soft, period=0.02).model.actuator("l_knee").gainprm[0] == 15.0
    for binding in (started, reloaded):
        assert binding.ratings.stiffness[KNEE] == 15.0
        assert binding.model.actuator_gainprm[servo, 0] == 15.0
        assert binding.model.actuator_biasprm[servo, 1] == -15.0
        assert np.array_equal(binding.model.actuator_forcerange[servo], limit)
    assert rebound(reloaded, robot, None).model.actuator_gainprm[servo, 0] == 30.0


def test_without_its_p_gain_an_identified_stiffness_stays_as_it_is() -> None:
    robot = at_gain(identified(stiffness_nm_per_rad=30.0), 400)
    assert bind(robot, None).ratings.stiffness[KNEE] == 30.0


def test_a_simulation_with_other_gains_goes_on_as_one_that_began_with_them() -> None:
    robot = identified_at_gain(stiffness_nm_per_rad=30.0, dead_band_rad=0.01, stribeck_nm=0.2, sag_per_nm=0.1)
    soft = at_gain(robot, 400)
    simulations = Simulation(bind(robot, None), PERIOD), Simulation(bind(soft, None), PERIOD)
    goals = STAND + 0.2 * (np.arange(24) == KNEE)
    simulations[0].step(goals)
    simulations[0].take_gains(rebound(bind(robot, None), soft, None))
    for each in simulations:
        each.place(STAND)
        for _ in range(20):
            each.step(goals)
    assert np.array_equal(simulations[0].state(0.0).position, simulations[1].state(0.0).position)


def test_an_identified_body_has_its_mass_and_centre_and_scaled_inertia() -> None:
    number = PLAIN.model.body("l_shin").id if "l_shin" in PLAIN.mjcf else 2
    name = PLAIN.model.body(number).name
    mass = float(PLAIN.model.body_mass[number])
    place = PositionEstimate((0.01, 0.0, -0.02), (0.0,) * 3, (0.0,) * 3)
    heavier = IdentifiedBody(ParameterEstimate(1.5 * mass, 0.0, mass, 0.0), place)
    model = bind(identified({name: heavier}), None).model
    assert model.body_mass[number] == pytest.approx(1.5 * mass)
    assert model.body_ipos[number] == pytest.approx([0.01, 0.0, -0.02])
    assert model.body_inertia[number] == pytest.approx(1.5 * PLAIN.model.body_inertia[number])
    assert model.body_mass.sum() == pytest.approx(PLAIN.model.body_mass.sum() + 0.5 * mass)


def test_a_body_that_the_model_lacks_is_refused_by_name() -> None:
    with pytest.raises(InvalidInput, match="no_body"):
        bind(identified({"no_body": IdentifiedBody()}), None)


def test_a_delayed_servo_follows_as_many_ticks_later() -> None:
    prompt = knee_path(PLAIN, STAND[KNEE] + 0.2, 40)
    late = knee_path(bind(identified(delay_s=0.03), None), STAND[KNEE] + 0.2, 40)
    assert np.abs(late[3:] - prompt[:-3]).max() < 1e-3
    assert np.abs(late[:3] - STAND[KNEE]).max() < 2e-3


def test_a_delayed_servo_holds_its_pose_after_a_restart() -> None:
    simulation = Simulation(bind(identified(delay_s=0.05), None), PERIOD)
    simulation.place(STAND)
    simulation.step(None)
    assert abs(simulation.state(0.0).position[KNEE] - STAND[KNEE]) < 2e-3


def test_a_restart_in_motion_goes_on_as_the_motion_without_it() -> None:
    binding = bind(identified(delay_s=0.03), None)
    whole = Simulation(binding, PERIOD)
    again = Simulation(binding, PERIOD)
    whole.place(STAND)
    goals = STAND + np.linspace(0.0, 0.3, 60)[:, None] * (np.arange(24) == KNEE)
    for goal in goals[:30]:
        whole.step(goal)
    state = whole.state(0.0)
    again.begin(state.position, state.velocity, goals[20:30])
    for goal in goals[30:]:
        whole.step(goal)
        again.step(goal)
    assert again.state(0.0).position == pytest.approx(whole.state(0.0).position, abs=2e-3)


def test_a_dead_band_lets_the_goal_move_by_half_of_it_without_motion() -> None:
    dead = bind(identified(dead_band_rad=0.04, friction_nm=0.0), None)
    free = bind(identified(friction_nm=0.0), None)
    rest = knee_path(dead, STAND[KNEE], 200)[-1]
    goal = STAND[KNEE] + 0.3
    assert knee_path(free, goal, 300)[-1] - knee_path(dead, goal, 300)[-1] == pytest.approx(0.02, abs=3e-3)
    assert abs(rest - STAND[KNEE]) < 0.04


def test_a_dead_band_of_a_delayed_servo_is_around_the_delayed_goal() -> None:
    prompt = knee_path(bind(identified(dead_band_rad=0.04), None), STAND[KNEE] + 0.2, 40)
    late = knee_path(bind(identified(dead_band_rad=0.04, delay_s=0.03), None), STAND[KNEE] + 0.2, 40)
    assert np.abs(late[3:] - prompt[:-3]).max() < 1e-3


def test_goals_of_delayed_servos_are_those_that_the_engine_reads() -> None:
    simulation = Simulation(bind(identified(dead_band_rad=0.04, delay_s=0.027), None), PERIOD)
    model, data = simulation.model, simulation.data
    rows = servo_rows(model, PLAIN.actuators)
    goals = DelayedGoals(model, rows, PLAIN.actuators)
    simulation.place(STAND)
    for tick in range(12):
        simulation.step(STAND + 0.01 * tick)
        read = [
            float(np.ravel(mujoco.mj_readCtrl(model, data, int(row), data.time, np.zeros((1, 1)), 1))[0])
            for row in rows
        ]
        assert goals.read(data) == pytest.approx(np.array(read), abs=1e-12)


def test_friction_near_rest_and_under_load_keeps_a_joint_from_a_small_step() -> None:
    step = STAND[KNEE] + 0.01  # 0.38 N·m at 38 N·m/rad
    moved = knee_path(PLAIN, step, 200)[-1] - knee_path(PLAIN, STAND[KNEE], 200)[-1]
    sticky = bind(identified(stribeck_nm=1.0), None)
    stuck = knee_path(sticky, step, 200)[-1] - knee_path(sticky, STAND[KNEE], 200)[-1]
    loaded = bind(identified(load_friction_per_nm=50.0), None)
    pressed = knee_path(loaded, step, 200)[-1] - knee_path(loaded, STAND[KNEE], 200)[-1]
    assert moved > 0.006
    assert abs(stuck) < 0.002
    assert abs(pressed) < 0.5 * moved


def test_a_sagging_supply_slows_a_step_that_takes_much_torque() -> None:
    sagging = bind(identified(sag_per_nm=0.2, friction_nm=0.1), None)
    firm = bind(identified(friction_nm=0.1), None)
    goal = STAND[KNEE] + 0.3
    moved = knee_path(firm, goal, 5)[-1] - STAND[KNEE]
    assert 0.2 * moved < knee_path(sagging, goal, 5)[-1] - STAND[KNEE] < 0.8 * moved


def test_the_encoder_stays_behind_the_joint_by_up_to_half_of_its_play() -> None:
    play = bind(identified(backlash_rad=0.02, friction_nm=0.1), None)
    firm = bind(identified(friction_nm=0.1), None)
    goal = STAND[KNEE] + 0.3
    behind = knee_path(firm, goal, 100) - knee_path(play, goal, 100)
    assert behind.max() == pytest.approx(0.01, abs=1e-9)
    assert behind.min() >= -0.01 - 1e-9
