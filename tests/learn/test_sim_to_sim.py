"""The same policy in the simulation of `policy check` and on the whole daemon, wire and estimate included."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.card_files import carded, linear
from tests.support.policy_files import plain
from tests.support.standing_policy import CARD, bending
from tests.support.standing_rig import StandingRig
from twind.config.robot_file import load_robot
from twind.learn.cards.card_file import load_any
from twind.learn.cards.driven_policy import actor_for, task_for
from twind.learn.cards.policy_rollout import roll_out
from twind.learn.environment.sim_body import SimBody
from twind.learn.policy.policy_card import PolicyRobot
from twind.learn.policy.policy_file import save
from twind.learn.randomise.randomisation_ranges import RandomisationRanges
from twind.learn.task.plant_model import plant_of

ROBOT = load_robot("h24-standing")
SECONDS = 3.0
NEAR = 0.2  # of the return
SQUAT = """\
format: twind-card/1
rate_hz: 50.0
joints: [l_knee, r_knee, l_hip_pitch, r_hip_pitch, l_ankle_pitch, r_ankle_pitch]
default_rad: {l_knee: 0.6, r_knee: 0.6, l_hip_pitch: -0.3, r_hip_pitch: -0.3, l_ankle_pitch: -0.3,
  r_ankle_pitch: -0.3}
phase: {period_s: 1.0}
inputs: {obs: {terms: {phase_sin: {}}}}
action: {output: actions, scale_rad: 0.2}
"""


@pytest.fixture
def rig() -> Iterator[StandingRig]:
    made = StandingRig()
    made.stand_up()
    yield made
    made.close()


@pytest.fixture(params=["trained here", "carded"])
def policy(request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    """A policy that bends its knees by its last actions, and one with a card that follows a phase."""
    if request.param == "trained here":
        save(tmp_path / "bends.onnx", bending(), *plain(CARD), CARD)
        return load_any(tmp_path / "bends.onnx")
    weight = [[1.0, 1.0, -0.5, -0.5, -0.5, -0.5]]
    return load_any(carded(tmp_path, linear(1, 6, weight=weight), SQUAT))


def test_knees_and_return_are_alike(rig: StandingRig, policy: Any) -> None:
    plant = plant_of(ROBOT, period=1.0 / ROBOT.rate_hz)
    described = PolicyRobot.from_limits("h24", plant.layout, plant.binding.limits, ROBOT.rate_hz)
    knee = ROBOT.names.index("l_knee")
    simulated: list[float] = []
    actor = actor_for(policy, described, plant.default)
    body = SimBody(plant, RandomisationRanges(), 1.0 / ROBOT.rate_hz)
    done = roll_out(
        actor,
        plant,
        body,
        task_for(policy),
        np.zeros(3),
        SECONDS,
        look=lambda body: simulated.append(float(body.data.qpos[plant.position][knee])),
    )
    driven: list[float] = []
    pilot = rig.pilots(policy)
    assert rig.drive(SECONDS, lambda step: driven.append(float(rig.state_message().position[knee]))) is None
    assert not done.ended and not done.refused and not rig.refused and not rig.told
    assert np.ptp(simulated) > 0.2
    here = done.returned / done.steps
    there = pilot.figures.returned / pilot.figures.judged
    assert abs(there - here) < NEAR * abs(here), (here, there)
    # The wire's way is two ticks: the daemon's knee is one step behind.
    away = np.array(driven[2:]) - np.array(simulated[: len(driven) - 2])
    assert np.sqrt(np.mean(away**2)) < NEAR * np.std(simulated), np.sqrt(np.mean(away**2)) / np.std(simulated)
    print(f"return per step {here:.3f} here, {there:.3f} there; knee off by {1e3 * away.std():.1f} mrad rms")
