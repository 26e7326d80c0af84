"""`twindctl calibrate prove` through a real daemon on virtual servos: who is proved, and who gets none."""

import json
import time
from collections.abc import Iterator
from typing import Any

import pytest
from processes import Daemon, Virtual, arm, daemon, robot

from twind.config.calibration_file import load_calibration
from twind.config.robot_file import load_robot
from twind.ctl.main import main

pytestmark = pytest.mark.realtime
Captured = pytest.CaptureFixture[str]
H24 = load_robot("h24")
TRUTH = {"joints": {"r_hip_pitch": {"sign": 1}}}  # the robot file says -1


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Virtual, Daemon]]:
    truth = tmp_path_factory.mktemp("truth") / "truth.json"
    truth.write_text(json.dumps(TRUTH))
    with robot("h24", "--truth", str(truth)) as (virtual, folder), daemon(virtual, folder) as one:
        one.reach(state="connected")
        yield virtual, one


def proved(one: Daemon, capsys: Captured, *words: str) -> tuple[int, list[dict[str, Any]]]:
    """Exit code, and its lines of JSON; once more where the machine had no time for the servos."""
    deadline = time.monotonic() + 60.0
    while True:
        capsys.readouterr()
        code = main(["--socket", str(one.sockets), "--json", "calibrate", "prove", "--yes", *words])
        told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        open_ones = [each for each in told if each.get("proof", "") is None]
        assert not open_ones or time.monotonic() < deadline, told
        if not open_ones:
            return code, told
        with one.client() as client:
            client.call("Reset")
            arm(client)


def test_who_is_proved_is_written_down_and_who_is_contradicted_is_not(
    running: tuple[Virtual, Daemon], capsys: Captured
) -> None:
    virtual, one = running
    with one.client() as client:
        arm(client)
    virtual.order(fault="lock", id=12)  # the waist is propped
    virtual.order(fault="lay", base="back")
    code, told = proved(one, capsys, "--base", "back", "l_hip_pitch", "r_hip_pitch")
    left, right, written = told
    assert code == 1
    assert (left["joint"], left["proof"], left["against"]) == ("l_hip_pitch", "proved", None)
    assert (right["joint"], right["proof"], right["against"]) == ("r_hip_pitch", "contradicted", "sign")
    assert right["like"] == ["l_hip_pitch"]
    assert written == {"written": str(virtual.calibration), "new": ["l_hip_pitch"], "gone": []}
    by_name = load_calibration(virtual.calibration, H24).by_name
    proof = by_name["l_hip_pitch"].proof
    assert isinstance(proof, dict)
    assert (proof["sign"], proof["base_pose"]) == ("gravity", "back")
    assert proof["slope_ratio"] == pytest.approx(1.0, abs=0.1)
    assert [name for name, entry in by_name.items() if entry.proof is not None] == ["l_hip_pitch"]
    assert main(["--socket", str(one.sockets), "reload"]) == 0
    assert "calibration.proof" in capsys.readouterr().out
