"""The tasks as data, and how a moment is judged."""

import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.learn.randomise.randomisation_ranges import ZERO, PushRanges, RandomisationRanges, load_ranges
from twind.learn.task.learning_tasks import HUMANOID, STAND, task_of
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import Plant, plant_of
from twind.learn.task.reward import LOW, RewardFunction

PERIOD = 0.02
NOTHING = np.zeros(3)


@pytest.fixture(scope="module")
def plant() -> Plant:
    return plant_of(load_robot("h24"), period=PERIOD)


def standing(plant: Plant, shape: tuple[int, ...] = ()) -> BodyReading:
    """At rest in the default pose."""
    reading = BodyReading.empty(len(plant.default), shape)
    reading.position[...] = plant.default
    reading.gravity[...] = (0.0, 0.0, -1.0)
    reading.soles[...] = [0.0, 0.05, -plant.height], [0.0, -0.05, -plant.height]
    reading.height[...] = plant.height
    return reading


def reward(
    plant: Plant, reading: BodyReading, task: str = "Stand", command: object = NOTHING
) -> dict[str, float]:
    judge = RewardFunction(task_of(task), plant)
    phase = task_of(task).phases(PERIOD)[0]
    total, terms = judge.reward(reading, plant.default, np.asarray(command), phase)
    assert total == pytest.approx(sum(terms.values()))
    return terms


def test_standing_still_as_asked_for_is_worth_the_most(plant: Plant) -> None:
    terms = reward(plant, standing(plant), "Stand")
    weigh = STAND.weights
    assert terms["velocity"] == weigh.velocity and terms["upright"] == weigh.upright
    assert [terms[name] for name in ("energy", "pose", "motion")] == [0.0, 0.0, 0.0]


def test_the_reward_grows_with_the_velocity_asked_for(plant: Plant) -> None:
    """Up to it: then it falls again."""
    found = []
    for speed in (0.0, 0.1, 0.2, 0.3):
        reading = standing(plant)
        reading.base_velocity[0] = speed
        found.append(reward(plant, reading, "Humanoid", (0.2, 0.0, 0.0))["velocity"])
    assert found[0] < found[1] < found[2] > found[3]
    assert found[2] == HUMANOID.weights.velocity


@pytest.mark.parametrize(
    ("term", "quantity", "off"),
    [
        ("pose", "position", 0.3),
        ("motion", "velocity", 1.0),
        ("energy", "position", 0.3),
        ("upright", "gravity", 0.2),
    ],
)
def test_a_deviation_reduces_its_own_reward_term(plant: Plant, term: str, quantity: str, off: float) -> None:
    reading = standing(plant)
    getattr(reading, quantity)[...] += off
    assert reward(plant, reading)[term] < reward(plant, standing(plant))[term]


def test_energy_is_the_mean_square_of_the_share_of_torque(plant: Plant) -> None:
    reading = standing(plant)
    soft = 0.5 * sum(STAND.stiffness)
    reading.position[:] -= 0.5 / (soft * plant.stiffness)
    reading.velocity[:] = 0.2 / plant.braking
    assert reward(plant, reading)["energy"] == pytest.approx(STAND.weights.energy * 0.3**2)
    reading.position[:] -= 10.0
    assert reward(plant, reading)["energy"] == pytest.approx(STAND.weights.energy)  # no servo has more


@pytest.mark.parametrize("task", ["Stand", "Humanoid"])
def test_energy_is_what_the_servos_of_the_simulation_do(task: str) -> None:
    """Within a quarter: what a gain is drawn around the middle, and a delay, nobody sees from outside."""
    pytest.importorskip("gymnasium", reason="make extras EXTRAS=learn")
    from twind.learn.environment.robot_env import RobotEnv

    env = RobotEnv(task)
    told = list[float]()
    true = list[float]()
    at = env.plant.places.actuators
    body = env.body
    most = body.model.actuator_forcerange[at, 1]
    rng = np.random.default_rng(0)
    for seed in range(6):
        env.reset(seed=seed)
        for _ in range(15):
            *_, info = env.step(rng.uniform(-0.2, 0.2, 24))
            told.append(info["energy"] / env.task.weights.energy)
            true.append(float(np.mean((body.data.actuator_force[at] / most) ** 2)))
    env.close()
    assert np.mean(told) == pytest.approx(np.mean(true), rel=0.25)


def test_the_swinging_foot_is_to_be_lifted_and_the_other_not(plant: Plant) -> None:
    phases = HUMANOID.phases(PERIOD)
    middle = phases[len(phases) // 4]  # of the left foot's swing
    judge = RewardFunction(HUMANOID, plant)
    found = []
    for left, right in ((0.0, 0.0), (HUMANOID.clearance, 0.0), (0.0, HUMANOID.clearance)):
        reading = standing(plant)
        reading.soles[0, 2] += left
        reading.soles[1, 2] += right
        found.append(judge.reward(reading, plant.default, NOTHING, middle)[1]["gait"])
    assert found[1] > found[0] > found[2]
    assert found[1] == pytest.approx(HUMANOID.weights.gait, rel=0.02)


@pytest.mark.parametrize(
    ("tilt", "height", "fallen"), [(0.9, 1.0, False), (1.2, 1.0, True), (0.0, 0.5, True)]
)
def test_too_far_tilted_or_too_low_is_fallen(plant: Plant, tilt: float, height: float, fallen: bool) -> None:
    reading = standing(plant)
    reading.gravity[...] = np.sin(tilt), 0.0, -np.cos(tilt)
    reading.height[...] = height * plant.height
    assert RewardFunction(STAND, plant).fallen(reading) is fallen
    assert LOW > 0.5


def test_left_and_right_are_judged_alike(plant: Plant) -> None:
    """A mirrored moment is worth the same, half a stride later."""
    rng = np.random.default_rng(3)
    reading = standing(plant)
    mirrored = standing(plant)
    reading.soles[...] += rng.uniform(-0.02, 0.02, (2, 3))
    reading.base_velocity[...] = rng.uniform(-0.3, 0.3, 3)
    mirrored.soles[...] = reading.soles[::-1] * (1.0, -1.0, 1.0)
    mirrored.base_velocity[...] = reading.base_velocity * (1.0, -1.0, 1.0)
    judge = RewardFunction(HUMANOID, plant)
    phases = HUMANOID.phases(PERIOD)
    for step in range(len(phases)):
        one = judge.reward(reading, plant.default, np.array([0.2, 0.1, 0.0]), phases[step])[0]
        later = phases[(step + len(phases) // 2) % len(phases)]
        other = judge.reward(mirrored, plant.default, np.array([0.2, -0.1, 0.0]), later)[0]
        assert one == pytest.approx(other, rel=1e-9)


def test_many_are_judged_as_each_alone(plant: Plant) -> None:
    rng = np.random.default_rng(2)
    many = standing(plant, (5,))
    many.values[...] += rng.uniform(-0.3, 0.3, many.values.shape)
    target = rng.uniform(-1, 1, (5, 24))
    command = rng.uniform(-0.3, 0.3, (5, 3))
    phase = HUMANOID.phases(PERIOD)[rng.integers(0, 30, 5)]
    together = RewardFunction(HUMANOID, plant, (5,))
    rewards, terms = together.reward(many, target, command, phase)
    fallen = together.fallen(many)
    judge = RewardFunction(HUMANOID, plant)
    for row in range(5):
        alone = BodyReading(many.values[row])
        reward, named = judge.reward(alone, target[row], command[row], phase[row])
        assert reward == rewards[row]
        assert {name: values[row] for name, values in terms.items()} == named
        assert judge.fallen(alone) == fallen[row]


def test_commands_are_drawn_within_their_spans() -> None:
    rng = np.random.default_rng(1)
    drawn = np.array([HUMANOID.draw_command(rng) for _ in range(200)])
    low, high = HUMANOID.command[0]
    assert low <= drawn[:, 0].min() < drawn[:, 0].max() <= high
    assert not drawn[:, 1:].any()


def test_feet_that_stay_have_one_phase_and_walking_ones_a_stride() -> None:
    assert STAND.phases(PERIOD).tolist() == [[0.0, 1.0, 0.0, 1.0]]
    stride = HUMANOID.phases(PERIOD)
    assert len(stride) == 30
    np.testing.assert_allclose(stride[:, :2], -stride[:, 2:], atol=1e-12)
    np.testing.assert_allclose((stride**2).sum(axis=1), 2.0)


def test_given_ranges_take_precedence_over_those_of_the_task() -> None:
    own = STAND.ranges(load_ranges(None))
    assert own.pushes == STAND.pushes and own.start_joints == STAND.start["start_joints"]
    given = RandomisationRanges(
        pushes=PushRanges((1.0, 1.0), (0.1, 0.1), (0.1, 0.1)), start_joints=(-0.5, 0.5)
    )
    both = STAND.ranges(given)
    assert both.pushes == given.pushes and both.start_joints == (-0.5, 0.5)
    assert both.start_tilt == STAND.start["start_tilt"] != ZERO


def test_a_task_is_found_by_name_and_others_are_named() -> None:
    assert task_of("stand") is STAND
    with pytest.raises(KeyError, match="no task 'Fly': Stand, Humanoid"):
        task_of("Fly")
