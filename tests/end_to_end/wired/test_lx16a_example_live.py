"""A robot of a third party's driver family, in real processes: checked, armed, moved, left by its daemon."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.processes import arm, daemon, go, robot, until
from tests.support.third_party_family import ROBOT, installed_family

GOAL = {"pan": 0.5, "lift": -0.3, "wrist": 0.4}


def counts(angles: dict[str, float]) -> list[float]:
    """Return the servos' counts at these angles: zeros at 500, 1500 counts a turn, `lift` reversed."""
    signs = {"pan": 1.0, "lift": -1.0, "wrist": 1.0}
    return [500.0 + signs[name] * angle * 1500.0 / 6.283185 for name, angle in angles.items()]


def test_an_arm_of_three_lx_16a_is_checked_armed_and_moved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = tmp_path / "truth.yaml"
    truth.write_text("joints:\n" + "".join(f"  {name}: {{zero_ticks: 500}}\n" for name in GOAL))
    with installed_family(tmp_path):
        check = [sys.executable, "-m", "twind.ctl.ctl_main", "check", "robot", str(ROBOT)]
        said = subprocess.run(check, capture_output=True, text=True, check=True).stdout
        assert "3 servos at 115200 baud" in said
        with (
            robot(str(ROBOT), "--truth", str(truth)) as (virtual, folder),
            daemon(virtual, folder) as running,
        ):
            running.reach(state="connected")
            with running.client() as client:
                arm(client)
                away = {"positions": list(GOAL.values()), "time_from_start": 2.0}
                go(client, {"joint_names": list(GOAL), "points": [away]})

            def arrived() -> bool:
                shown = [servo["position"] for servo in virtual.servos()]
                return max(abs(a - b) for a, b in zip(shown, counts(GOAL), strict=True)) < 25

            until(arrived, 5.0, lambda: f"{virtual.servos()} are not at {counts(GOAL)}")
            running.end(signal.SIGKILL)
            held = virtual.servos()
            assert all(servo["torque"] for servo in held), "a servo without watchdog holds its last goal"
            assert arrived()
