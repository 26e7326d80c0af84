"""Policies that another framework trained (docs/examples/squat) move a virtual robot through bus and gate."""

import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.policy_files import Run
from tests.support.processes import arm, daemon, robot, until

SQUATS = Path(__file__).parents[2] / "data" / "policies" / "squat"
PERIOD = 2.0  # s, of a squat
HALF = 0.02  # m, half of its depth
pytestmark = pytest.mark.slow


def fitted(times: np.ndarray, heights: np.ndarray) -> tuple[float, float]:
    """Amplitude of the period of a squat in the heights, m, and the rest, m, rms."""
    turn = 2.0 * np.pi * times / PERIOD
    basis = np.stack([np.ones_like(turn), np.cos(turn), np.sin(turn)], axis=1)
    found = np.linalg.lstsq(basis, heights, rcond=None)[0]
    return float(np.hypot(*found[1:])), float(np.std(heights - basis @ found))


@pytest.mark.parametrize("name", ["squat", "squat_lstm"])
def test_the_body_goes_down_and_up_in_time(name: str) -> None:
    times: list[float] = []
    heights: list[float] = []
    with robot("h24-standing") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        with running.client() as client:
            arm(client)
        until(lambda: not virtual.order(query="state")["body"]["held"], 10.0, "the hands let go")
        run = Run(running, SQUATS / f"{name}.onnx", "--seconds", "12")
        run.drives(2.0)
        begun = time.monotonic()
        while (now := time.monotonic() - begun) < 8.0:
            heights.append(virtual.order(query="state")["body"]["position"][2])
            times.append(now)
            time.sleep(0.02)
        code, told, errors = run.end()
    assert code == 0 and told["refused"] == 0 and told["holds"] == 0, (told, errors)
    amplitude, rest = fitted(np.array(times), np.array(heights))
    print(f"{name}: amplitude {1e3 * amplitude:.1f} mm, rest {1e3 * rest:.1f} mm rms, {told}")
    assert abs(amplitude - HALF) < 0.2 * HALF and rest < 0.2 * HALF
