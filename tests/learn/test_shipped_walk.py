"""The policy that comes with h24-standing walks as it is asked to."""

import math
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="make extras EXTRAS=learn")
pytest.importorskip("mink", reason="the extra walk")

from tests.support.standing_rig import StandingRig
from twind import robots
from twind.config.robot_file import load_robot
from twind.learn.batch.batch_core import BatchCore
from twind.learn.cards.card_file import load_any
from twind.learn.cards.driven_policy import actor_for
from twind.learn.cards.policy_rollout import roll_out
from twind.learn.environment.sim_body import SimBody
from twind.learn.policy.policy_card import PolicyRobot
from twind.learn.policy.policy_file import read
from twind.learn.randomise.randomisation_ranges import RandomisationRanges
from twind.learn.task.learning_tasks import WALK
from twind.learn.task.plant_model import plant_of
from twind.virtual.robot_ground_truth import random_truth

FILE = Path(robots.__file__).with_name("h24-standing.walk.onnx")
LARGEST = 1_000_000  # bytes
PERIOD = WALK.shaping.period
COMMAND = (0.15, 0.0, 0.0)  # m/s forward
SECONDS = 40.0
NEAR = 0.2  # of the return, and of the spread of a joint


def walked(
    speed: float, seconds: float, seeds: range, randomise: str | None
) -> tuple[np.ndarray, np.ndarray]:
    """Distance along the robot's own front, m, and whether it fell, of each seed."""
    count = len(seeds)
    core = BatchCore(
        "Walk",
        count,
        robot="h24-standing",
        randomise=randomise,
        episode_steps=round(seconds / PERIOD) + 1,
    )
    core.seed(list(seeds))
    observation = core.reset(command=(speed, 0.0, 0.0))
    act = read(FILE.read_bytes()).act
    way = np.zeros(count)
    fallen = np.zeros(count, np.bool_)
    for _ in range(round(seconds / PERIOD)):
        step = core.step(act(observation))
        observation = step.observation
        fallen |= step.fallen
        way += ~fallen * core.body.reading.base_velocity[:, 0] * PERIOD
    return way, fallen


def test_it_walks_and_its_file_is_small() -> None:
    way, fallen = walked(0.15, 8.0, range(2), None)
    assert not fallen.any()
    assert (way > 0.6).all()
    assert FILE.stat().st_size < LARGEST


def test_a_command_of_zero_leaves_it_standing() -> None:
    way, fallen = walked(0.0, 4.0, range(2), None)
    assert not fallen.any()
    assert (np.abs(way) < 0.1).all()


@pytest.mark.campaign
@pytest.mark.parametrize("randomise", [None, "walk"])
def test_it_walks_five_metres_at_the_commanded_speed(randomise: str | None) -> None:
    way, fallen = walked(0.15, 40.0, range(100, 110), randomise)
    print(f"{randomise}: {np.round(way, 2)}, {fallen.sum()} of {len(fallen)} fell")
    assert fallen.sum() == 0
    assert (way >= 5.0).all()


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(10))
def test_it_walks_five_metres_through_gate_and_virtual_servos_of_unknown_friction_and_play(seed: int) -> None:
    truth = random_truth(load_robot("h24-standing"), seed)
    with closing(StandingRig(truth=truth)) as rig:
        way, end = through_the_daemon(rig, 0.0)
        print(f"seed {seed}: {way:.2f} m, {end}, refused {dict(rig.refused)}")
        assert end is None and not rig.refused and not rig.told
        assert way >= 5.0


@pytest.mark.campaign
@pytest.mark.parametrize("eighth", range(8))
def test_it_bears_pushes_while_it_walks(eighth: int) -> None:
    with closing(StandingRig()) as rig:
        way, end = through_the_daemon(rig, 0.3, eighth * math.pi / 4)
        print(f"pushes towards {45 * eighth} degrees: {way:.2f} m, {end}, refused {dict(rig.refused)}")
        assert end is None


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [None, 0, 1, 2, 3, 4])
def test_return_and_joints_are_alike_in_training_simulation_and_daemon(seed: int | None) -> None:
    """`seed`: of friction and play of the robot behind the daemon, which the simulation lacks."""
    robot = load_robot("h24-standing")
    plant = plant_of(robot, period=1.0 / robot.rate_hz)
    described = PolicyRobot.from_limits(robot.name, plant.layout, plant.binding.limits, robot.rate_hz)
    body = SimBody(plant, RandomisationRanges(), 1.0 / robot.rate_hz)
    simulated: list[np.ndarray] = []
    done = roll_out(
        actor_for(load_any(FILE), described, plant.default),
        plant,
        body,
        WALK,
        np.array(COMMAND),
        SECONDS,
        look=lambda body: simulated.append(body.data.qpos[plant.position].copy()),
    )
    driven: list[np.ndarray] = []
    with closing(StandingRig(truth=None if seed is None else random_truth(robot, seed))) as rig:
        _, end = through_the_daemon(rig, 0.0, look=lambda: driven.append(rig.state_message().position))
        assert end is None and not done.ended and rig.pilot is not None
        there = rig.pilot.figures.returned / rig.pilot.figures.judged
    here = done.returned / done.steps
    legs = [place for place, name in enumerate(robot.names) if name in robot.legs]
    # The wire's way is two ticks: the daemon's joints are one step behind.
    away = (np.array(driven[1:]) - np.array(simulated[: len(driven) - 1]))[:, legs]
    gap = np.sqrt((away**2).mean(axis=0)) / np.std(simulated, axis=0)[legs]
    print(
        f"robot {seed}: return per step {here:.3f}, {there:.3f}; joints {np.median(gap):.3f}, {gap.max():.3f}"
    )
    assert abs(there - here) < NEAR * abs(here)
    assert np.median(gap) < NEAR


def through_the_daemon(
    rig: StandingRig, push: float, direction: float = 0.0, look: Callable[[], None] = lambda: None
) -> tuple[float, str | None]:
    """Walk at 0.15 m/s, pushed by N·s every 4 s; the way by strides, m, and why it ended early."""
    rig.stand_up()
    rig.pilots(load_any(FILE), COMMAND)
    places: list[np.ndarray] = []

    def each(step: int) -> None:
        look()
        places.append(rig.body.data.qpos[:2].copy())
        if push and step % 200 == 199:
            rig.base_support.push(push * math.cos(direction), push * math.sin(direction))

    end = rig.drive(SECONDS, each)
    strides = np.array(places)[:: round(WALK.stride / PERIOD)]
    return float(np.linalg.norm(np.diff(strides, axis=0), axis=1).sum()), end
