"""`twindctl replay` as a user calls it: a daemon of its own before pseudo-terminals, in real time."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from tests.support.golden_captures import HERE, Hand, expected, outcome_of, record, silent
from twind.flight import load
from twind.loop.process.realtime import PRIORITY as ROBOT
from twind.observe.replaying import exec_with_priority

TRIES = 3  # on a machine that is too busy for a daemon and its servos bus errors come that were not recorded


def replayed(file: Path, folder: Path, *options: str) -> dict[str, Any]:
    """Output of `replay --json`, of the first try for which this machine had time."""
    folder.mkdir()
    before = set(Path(tempfile.gettempdir()).glob("twind-replay-*"))
    said: dict[str, Any] = {}
    for _ in range(TRIES):
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "twind.ctl.ctl_main",
                "replay",
                "--json",
                "--realtime",
                *options,
                str(file),
            ],
            capture_output=True,
            text=True,
            timeout=120,
            env={"PATH": "/usr/bin:/bin", "HOME": str(folder)},
            check=False,
        )
        said = json.loads(done.stdout or "{}")
        if done.returncode == 0:
            assert list(folder.iterdir()) == [], "nothing is written to the user's own folders"
            assert set(Path(tempfile.gettempdir()).glob("twind-replay-*")) <= before, "nothing is left behind"
            return said
        print(done.stderr, said.get("differences", said))
        if not said.get("missed"):
            break
    raise AssertionError(f"{file}: {said.get('differences')}")


def moved_and_silent(hand: Hand) -> None:
    """A client moves the robot and is gone; in the next motion a servo falls silent."""
    hand.ask("ReleaseLease")
    move = ["--socket", str(hand.running.sockets), "move", "head_yaw=0.1", "--time", "1"]
    subprocess.run([sys.executable, "-m", "twind.ctl.ctl_main", *move], timeout=30, check=True)
    silent(hand)


def test_a_recorded_fault_replays_to_the_same_refusal(tmp_path: Path) -> None:
    """A robot whose servo falls silent, what its daemon dumps, and that played into another daemon."""
    file = tmp_path / "silent.flight"
    begun = record(moved_and_silent, file)
    recorded = load(file)
    assert not recorded.briefing.binding and not recorded.briefing.described
    last = recorded.contents.entries[-1].time - begun
    said = replayed(file, tmp_path / "replay", "--last", f"{last:.3f}")
    assert said["differences"] == []
    for told in (said["recorded"], said["replayed"]):
        moved = next(place for place, each in enumerate(told["answers"]) if each["phase"] == "succeeded")
        released = told["answers"][moved + 1]
        assert (released["method"], released["answered"]) == ("ReleaseLease", True)
        *_, last = (each for each in told["answers"] if each["method"] == "SubmitTrajectory")
        assert last["error"] == "Refused"
        assert "FAULT_LATCHED" in [each["code"] for each in last["findings"]]
        assert ("STATE_STALE", "l_shoulder_pitch") in [
            (each["code"], each["joint"]) for each in told["faults"]
        ]
        assert told["state"] == "fault"


def test_a_golden_capture_comes_out_of_a_real_daemon(tmp_path: Path) -> None:
    said = replayed(HERE / "limit.flight", tmp_path / "replay")
    assert outcome_of(said["recorded"]) == expected("limit")
    assert [each["findings"] for each in said["replayed"]["answers"]] == [
        each["findings"] for each in said["recorded"]["answers"]
    ]
    assert said["verbatim"] > 0.3


@pytest.mark.parametrize("asked", [0, exec_with_priority.DAEMON])
def test_a_daemon_of_a_replay_never_goes_before_that_of_a_robot(asked: int) -> None:
    ask = f"import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({ROBOT}))"
    python = [sys.executable, "-P"]
    if subprocess.run([*python, "-c", ask], capture_output=True, check=False).returncode:
        pytest.skip("nobody here may ask for real-time scheduling, so there is no right to be given up")
    tell = "import os; print(os.sched_getparam(0).sched_priority, flush=True); "
    done = subprocess.run(
        [*python, "-m", exec_with_priority.__name__, str(asked), *python, "-c", tell + ask],
        capture_output=True,
        text=True,
        check=False,
    )
    assert asked < exec_with_priority.PORTS < ROBOT
    assert done.stdout.split() == [str(asked)]
    assert done.returncode and "PermissionError" in done.stderr, done.stderr
