"""Policies that another framework trained (docs/examples/squat): in the check and on the whole daemon.

One is feed-forward; the recurrent one sees neither velocities of joints nor the whole clock.
"""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.simulated_drives import simulated_drive
from tests.support.standing_rig import StandingRig
from twind.ctl.ctl_main import main
from twind.learn.cards.card_file import load_any
from twind.learn.environment.sim_body import SimBody

SQUATS = Path(__file__).parents[1] / "data" / "policies" / "squat"
NETWORKS = [SQUATS / "squat.onnx", SQUATS / "squat_lstm.onnx"]
SECONDS = 6.0
RATE = 50
PERIOD = 2.0  # s, of a squat
DEPTH = 0.04  # m
STANDING_STILL = 0.0245  # m, rms: the error of a robot that does not move


def error(heights: list[float]) -> float:
    """Error of the height, m, rms. `heights`: m, of the base after 0, 1, ... steps."""
    clock = 2.0 * np.pi * np.arange(len(heights)) / RATE / PERIOD
    wanted = heights[0] - 0.5 * DEPTH * (1.0 - np.cos(clock))
    return float(np.sqrt(np.mean(np.square(np.array(heights) - wanted))))


@pytest.mark.parametrize("path", NETWORKS, ids=lambda path: path.stem)
def test_the_check_passes(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["policy", "check", str(path), "--seconds", "2", "--json"]) == 0
    lines = {each["name"]: each for each in map(json.loads, capsys.readouterr().out.splitlines())}
    assert lines["vectors"]["verdict"] == lines["drive"]["verdict"] == lines["gate"]["verdict"] == "ok"
    assert lines["collision"]["verdict"] == "ok"


@pytest.mark.parametrize("path", NETWORKS, ids=lambda path: path.stem)
def test_the_squat_is_followed_in_the_check_and_on_the_daemon(path: Path, rig: StandingRig) -> None:
    heights: list[float] = []

    def look(body: SimBody) -> None:
        heights.append(float(body.data.qpos[body.plant.places.base_qpos + 2]))

    done = simulated_drive(load_any(path), SECONDS, look)
    driven: list[float] = []
    rig.pilots(load_any(path))
    assert rig.drive(SECONDS, lambda step: driven.append(rig.base()["position"][2])) is None
    assert not done.ended and not done.refused and not rig.refused and not rig.told
    print(f"height off by {1e3 * error(heights):.1f} mm rms in the check, {1e3 * error(driven):.1f} mm there")
    assert error(heights) < 0.3 * STANDING_STILL
    assert error(driven) < 0.3 * STANDING_STILL
