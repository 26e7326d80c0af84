"""Policies that another framework trained (docs/examples/squat) move a virtual robot through bus and gate."""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.policy_files import Run
from tests.support.processes import arm, daemon, robot, until

SQUATS = Path(__file__).parents[2] / "data" / "policies" / "squat"
SETTLED = 0.5  # s, then a squat that began anew is followed
PERIOD = 2.0  # s, of a squat
HALF = 0.02  # m, half of its depth
pytestmark = pytest.mark.slow


def undisturbed(reports: list[dict[str, Any]]) -> tuple[float, float]:
    """Begin and end of the longest time without a hold, s of the run; a hold begins the squat anew."""
    spans: dict[int, list[float]] = {}
    for report in reports:
        spans.setdefault(report["holds"], []).append(report["seconds"])
    longest = max(spans.values(), key=lambda span: span[-1] - span[0])
    return longest[0], longest[-1]


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
        try:
            begun = time.monotonic() - run.drives()["seconds"]
            while (now := time.monotonic() - begun) < 11.5:
                heights.append(virtual.order(query="state")["body"]["position"][2])
                times.append(now)
                time.sleep(0.02)
            out, errors = run.process.communicate(timeout=30.0)
        finally:
            run.kill()
    reports = [json.loads(line) for line in out.splitlines()]
    assert run.process.returncode == 0 and reports[-1]["refused"] == 0, (reports[-1], errors)
    first, last = undisturbed([each for each in reports if each["phase"] == "running"])
    counted = (np.array(times) > first + SETTLED) & (np.array(times) < last)
    amplitude, rest = fitted(np.array(times)[counted], np.array(heights)[counted])
    print(f"{name}: {last - first:.1f} s, amplitude {1e3 * amplitude:.1f} mm, rest {1e3 * rest:.1f} mm rms")
    print(reports[-1])
    assert last - first > SETTLED + PERIOD, f"the machine is too busy: {errors}"
    assert abs(amplitude - HALF) < 0.2 * HALF and rest < 0.2 * HALF
