"""The same policy in the simulation of `policy check` and on the whole daemon, wire and estimate included."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.card_files import FOREARM, INTO_PELVIS, carded, linear
from tests.support.policy_files import plain
from tests.support.simulated_drives import ROBOT, simulated_drive
from tests.support.standing_policy import CARD, bending
from tests.support.standing_rig import StandingRig
from twind.learn.cards.card_file import load_any
from twind.learn.policy.policy_file import save

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


@pytest.fixture(params=["trained here", "carded"])
def policy(request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    """A policy that bends its knees by its last actions, and one with a card that follows a phase."""
    if request.param == "trained here":
        save(tmp_path / "bends.onnx", bending(), *plain(CARD), CARD)
        return load_any(tmp_path / "bends.onnx")
    weight = [[1.0, 1.0, -0.5, -0.5, -0.5, -0.5]]
    return load_any(carded(tmp_path, linear(1, 6, weight=weight), SQUAT))


def test_knees_and_return_are_alike(rig: StandingRig, policy: Any) -> None:
    knee = ROBOT.names.index("l_knee")
    simulated: list[float] = []
    done = simulated_drive(
        policy, SECONDS, lambda body: simulated.append(float(body.data.qpos[body.plant.position][knee]))
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


def test_a_forearm_on_its_way_into_the_pelvis_is_held_in_both_at_the_same_time(
    rig: StandingRig, tmp_path: Path
) -> None:
    policy = load_any(carded(tmp_path, linear(2, 2, bias=INTO_PELVIS), FOREARM))
    done = simulated_drive(policy, 1.0)
    assert "LOOKAHEAD_COLLISION" in done.ended and done.slowed.keys() == {"l_forearm-pelvis"}
    rig.pilots(policy)
    held: list[int] = []

    def look(step: int) -> None:
        if any(event.stop == "hold" for event in rig.events("LOOKAHEAD_COLLISION")):
            held.append(step)

    rig.drive(1.0, look)
    assert abs(held[0] - done.steps) <= 1
    assert rig.refused["SELF_COLLISION"]  # it goes on after the hold; a check ends there
