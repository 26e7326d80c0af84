"""`twindctl follow`: two daemons in mode sim, one of them the leader, and its loss."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice, pairwise
from pathlib import Path

import pytest

from tests.support.processes import Daemon, patiently, until
from twind import Robot
from twind.client import ClientError

JOINT = "head_yaw"


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[Daemon, Daemon]]:
    daemons = [Daemon(tmp_path / name, "--mode", "sim") for name in ("leader", "follower")]
    for each in daemons:
        each.reach(sim_connected=True)
    yield daemons[0], daemons[1]
    for each in daemons:
        each.kill()


def moved_until_lost(hand: Robot) -> None:
    with suppress(ClientError):
        hand.move({JOINT: -0.4}, time=6.0)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_follower_follows_mirrored_and_holds_when_the_leader_is_lost(
    pair: tuple[Daemon, Daemon], number: signal.Signals, tmp_path: Path
) -> None:
    leader, follower = pair
    places = [str(leader.sockets), str(follower.sockets)]
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "follow", *places]
    with (tmp_path / "said").open("w") as said:
        following = subprocess.Popen([*command, "--scale", f"{JOINT}=-1"], stderr=said)
    try:
        until(lambda: "following 24 joints" in (tmp_path / "said").read_text(), 30.0, "it does not follow")
        with Robot(leader.sockets) as hand, Robot(follower.sockets, read_only=True, state_rate=100.0) as seen:
            patiently(lambda: hand.move({JOINT: 0.4}, time=2.0))
            until(
                lambda: abs(seen.joints[JOINT].position + 0.4) < 0.02,
                5.0,
                lambda: f"the follower does not come there: {(tmp_path / 'said').read_text()}",
            )
            assert following.poll() is None, (tmp_path / "said").read_text()
            moving = threading.Thread(target=moved_until_lost, args=(hand,))
            moving.start()
            time.sleep(1.5)
            assert (seen.joints[JOINT].goal or 0.0) > -0.38  # on its way back
            front = leader.front()
            lost = time.monotonic()
            os.kill(leader.process.pid, number)
            os.kill(front, number)
            goals = [(each.stamp, each.joints[JOINT].goal) for each in islice(seen.states(), 100)]
            assert following.wait(10.0) == 1
            changes = [now for (_, old), (now, new) in pairwise(goals) if old != new]
            print(f"last change of the goal {max(changes, default=lost) - lost:.3f} s after the loss")
            assert max(changes, default=lost) - lost < 0.5
            leader.kill()
            moving.join()
        assert "the follower holds" in (tmp_path / "said").read_text()
    finally:
        following.kill()
        following.wait(10.0)
