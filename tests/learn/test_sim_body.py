"""The simulated body: the physics of the plant itself, told at the end of each period."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.learn.environment.sim_body import SimBody
from twind.learn.randomise.randomisation_ranges import PushRanges, RandomisationRanges
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import Plant, plant_of
from twind.robot.arrays import Floats

PERIOD = 0.02


@pytest.fixture(scope="module")
def plant() -> Plant:
    return plant_of(load_robot("h24"), period=PERIOD)


def targets(plant: Plant, count: int = 25) -> Floats:
    rng = np.random.default_rng(0)
    return plant.default + rng.uniform(-0.1, 0.1, (count, len(plant.default)))


def test_each_reading_equals_that_of_the_bare_physics(plant: Plant) -> None:
    """Sensors that are worked out once a period are those of every step, and no state is another."""
    body = SimBody(plant, RandomisationRanges(), PERIOD)
    body.reset(np.random.default_rng(0))
    bare = mujoco.MjData(plant.model)
    expected = BodyReading.empty(len(plant.default))
    bare.qpos[:] = plant.stance
    bare.ctrl[:] = plant.control
    mujoco.mj_forward(plant.model, bare)
    for target in targets(plant):
        reading = body.advance(target, np.zeros(len(target)))
        bare.ctrl[plant.goals] = target
        for _ in range(plant.substeps):
            mujoco.mj_step2(plant.model, bare)
            mujoco.mj_step1(plant.model, bare)
        plant.read(bare.qpos, bare.qvel, bare.sensordata, expected)
        np.testing.assert_array_equal(reading.values, expected.values)
    assert body.data.time == pytest.approx(len(targets(plant)) * PERIOD)


def test_physics_without_islands_equals_physics_with_islands_within_rounding(plant: Plant) -> None:
    """The plant does not look for islands: what comes of it differs by rounding."""
    model = mujoco.MjModel.from_xml_path(str(load_robot("h24").mjcf_path))
    assert not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ISLAND
    one = mujoco.MjData(plant.model)
    other = mujoco.MjData(model)
    for target in targets(plant, 10):
        for m, d in ((plant.model, one), (model, other)):
            if d.time == 0.0:
                d.qpos[:] = plant.stance
            d.ctrl[:] = target
            mujoco.mj_step(m, d, 4)
    np.testing.assert_allclose(one.qpos, other.qpos, atol=1e-6)


def test_joints_in_any_order_are_read_and_driven_by_name() -> None:
    robot = load_robot("h24")
    turned = replace(robot, joints=tuple(reversed(robot.joints)))
    one, other = (
        SimBody(plant_of(each, period=PERIOD), RandomisationRanges(), PERIOD) for each in (robot, turned)
    )
    rng = np.random.default_rng(0)
    one.reset(rng)
    other.reset(rng)
    assert one.plant.steady and not other.plant.steady
    for target in targets(one.plant, 10):
        first = one.advance(target, np.zeros(24))
        second = other.advance(target[::-1], np.zeros(24))
        np.testing.assert_array_equal(first.position, second.position[::-1])
        np.testing.assert_array_equal(first.base, second.base)


def test_an_action_delay_of_one_period_shifts_the_motion_by_one_period(plant: Plant) -> None:
    late = plant_of(load_robot("h24"), period=PERIOD, action_delay=PERIOD)
    prompt = SimBody(plant, RandomisationRanges(), PERIOD)
    delayed = SimBody(late, RandomisationRanges(action_delay=(PERIOD, PERIOD)), PERIOD)
    rng = np.random.default_rng(0)
    still = np.zeros(24)
    prompt.reset(rng)
    delayed.reset(rng)
    goal = targets(plant, 1)[0]
    prompt.advance(plant.default, still)
    expected = prompt.advance(goal, still).position.copy()
    delayed.advance(goal, still)
    np.testing.assert_allclose(delayed.advance(plant.default, still).position, expected, atol=1e-12)


def test_the_first_delayed_imu_reading_is_that_of_a_robot_at_rest() -> None:
    late = plant_of(load_robot("h24"), period=PERIOD, imu_delay=2 * PERIOD)
    body = SimBody(
        late, RandomisationRanges(imu_delay=(2 * PERIOD, 2 * PERIOD), start_tilt=(0.05, 0.05)), PERIOD
    )
    first = body.reset(np.random.default_rng(0)).base[:9].copy()
    np.testing.assert_allclose(first[3:6], -9.81 * first[6:9], rtol=1e-12)
    assert abs(first[3]) > 0.1, "it stands askew"
    np.testing.assert_array_equal(body.advance(late.default, np.zeros(24)).base[:9], first)
    body.advance(late.default, np.zeros(24))
    assert (body.advance(late.default, np.zeros(24)).base[:9] != first).any()


def test_a_push_changes_the_base_speed_by_the_drawn_amount(plant: Plant) -> None:
    """A robot in the air gains the speed that the range names."""
    pushes = PushRanges(every=(0.02, 0.02), speed=(0.5, 0.5), lasting=(0.1, 0.1))
    body = SimBody(plant, RandomisationRanges(pushes=pushes), PERIOD)
    body.reset(np.random.default_rng(0))
    body.data.qpos[2] += 5.0
    for _ in range(6):  # the first without, five with
        body.advance(plant.default, np.zeros(24))
    mujoco.mj_subtreeVel(body.model, body.data)
    velocity = body.data.subtree_linvel[plant.places.base]
    assert float(np.hypot(*velocity[:2])) == pytest.approx(0.5, rel=0.02)
