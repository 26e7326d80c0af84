"""A hand guides limp virtual servos, `twindctl teach` records it, and `twindctl play` repeats it."""

import json
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.doc_pages_text import ROOT
from tests.support.processes import BUSY, Daemon, Virtual, arm, daemon
from twind.ctl.ctl_main import main
from twind.robot.arrays import Floats

SECONDS = 4.0
REACH = {"shoulder_pitch": -0.7, "shoulder_roll": 0.4, "elbow": -0.9}  # rad
START = {"shoulder_pitch": -0.2, "shoulder_roll": 0.1, "elbow": -0.4}
CLOSE = 0.02  # rad


class Watched(threading.Thread):
    """States of a daemon from beside the tested program: times (k,), positions and goals (k, n)."""

    def __init__(self, running: Daemon) -> None:
        super().__init__(daemon=True)
        self._client = running.client()
        self._client.connect()
        self._rows: list[tuple[float, list[Any], list[Any]]] = []
        self._ended = False
        self.start()

    def run(self) -> None:
        for state in self._client.stream("Monitor", topics=["state"], rate=100.0):
            rows = state["joints"]
            row = (state["time"], [each["position"] for each in rows], [each["goal"] for each in rows])
            self._rows.append(row)
            if self._ended:
                break

    def result(self) -> tuple[Floats, Floats, Floats]:
        self._ended = True
        self.join(5.0)
        self._client.close()
        times, positions, goals = zip(*self._rows, strict=True)
        return np.array(times), np.array(positions, np.float64), np.array(goals, np.float64)


@contextmanager
def guided(virtual: Virtual) -> Iterator[None]:
    """A hand that swings all joints to REACH and back, once, within SECONDS."""
    ended = threading.Event()

    def move() -> None:
        begun = time.monotonic()
        while not ended.wait(0.01):
            phase = min(1.0, max(0.0, time.monotonic() - begun - 0.5) / SECONDS)
            share = sin(pi * phase) ** 2
            pose = {name: START[name] + share * (REACH[name] - START[name]) for name in REACH}
            virtual.order(fault="hand", pose=pose, speed=1.0)

    hand = threading.Thread(target=move)
    hand.start()
    try:
        yield
    finally:
        ended.set()
        hand.join()


def farthest(hand: tuple[Floats, Floats], time: Floats, path: Floats) -> tuple[float, float]:
    """Largest distance of `path` from the hand's moving part, and the constant delay (s) that suits best."""
    begun, row = hand
    found = []
    for shift in np.arange(time[0], time[-1] - (begun[-1] - begun[0]), 0.002):
        other = np.array([np.interp(begun - begun[0] + shift, time, each) for each in path.T]).T
        found.append((float(np.abs(other - row).max()), float(shift)))
    return min(found)


def moving(time: Floats, path: Floats) -> tuple[Floats, Floats]:
    """The part between the first and the last movement."""
    away = np.abs(path - path[0]).max(axis=1) > 0.005
    back = np.abs(path - path[-1]).max(axis=1) > 0.005
    first = int(np.flatnonzero(away)[0])
    last = int(np.flatnonzero(back)[-1])
    return time[first:last], path[first:last]


def play(running: Daemon, name: str) -> None:
    """Play it; again where the machine had no time."""
    deadline = time.monotonic() + 30.0
    while main(["--socket", str(running.sockets), "play", name, "--approach"]) != 0:
        faults = {each["code"] for each in running.status()["faults"]}
        assert time.monotonic() < deadline
        assert faults <= BUSY
        time.sleep(0.5)


def test_a_taught_motion_is_played_as_the_hand_guided_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(ROOT / "docs" / "examples" / "arm", tmp_path / "arm")
    virtual = Virtual(tmp_path, str(tmp_path / "arm" / "arm.yaml"), "--muscles", "first-order")
    try:
        with daemon(virtual, tmp_path) as running:
            running.reach(state="connected")
            virtual.order(fault="hand", pose=START, speed=3.0)
            time.sleep(0.5)
            watched = Watched(running)
            with guided(virtual):
                words = ["--json", "--socket", str(running.sockets)]
                assert main([*words, "teach", "swing", "--seconds", str(SECONDS + 1.0)]) == 0
            hand = moving(*watched.result()[:2])
            told = json.loads(capsys.readouterr().out)
            assert told["path"] == str(tmp_path / "arm" / "motions" / "swing.json")
            assert told["deviation"] <= 0.0101
            assert told["added"] <= 0.5, told["slowed_for"]
            assert told["points"] <= 20
            assert main([*words, "teach", "swing", "--seconds", "1"]) == 1  # it is there
            assert "--force" in capsys.readouterr().out

            virtual.order(fault="hand", off=True)
            with running.client() as client:
                arm(client)
            watched = Watched(running)
            play(running, "swing")
            clock, measured, commanded = watched.result()
            known = np.isfinite(commanded).all(axis=1)
            far = farthest(hand, clock[known], commanded[known])
            seen = farthest(hand, clock, measured)
            print(f"commanded {far[0]:.4f} rad, measured {seen[0]:.4f} rad, {seen[1] - far[1]:.3f} s later")
            assert far[0] <= CLOSE
            assert seen[0] <= CLOSE
            assert seen[1] - far[1] <= 0.1
    finally:
        virtual.close()
