"""Clients of a replay hang up as they did: with the answers that they had, whenever those come now."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twind import link
from twind.observe.replaying import replay_client
from twind.observe.replaying.replay_calls import Reply
from twind.observe.replaying.replay_client import ReplayClient
from twind.observe.replaying.replay_outcome import RunOutcome
from twind.observe.replaying.replay_script import STAY, Heard, RecordedCommand, ReplayScript
from twind.observe.replaying.replay_servos import ReplayPosition
from twind.robot.trajectory import Trajectory
from twind_drivers.clock import FakeClock

BEGIN = 100.0  # s, of the recording
MOTION = 1.0  # s from the call to the last answer
SOON = 0.004  # s to any other answer
STATUS = {"state": "armed", "mode": "live", "armed": True, "faults": [], "loop": {"missed": 0}}
# clients
ONE = 3
OTHER = 4
PATH = Trajectory(np.array([MOTION]), np.zeros((1, 1)), np.ones(1, np.bool_))
SCENE = (
    (0.000, link.AcquireLease(ticket=1, client=ONE)),
    (0.010, link.Submit(ticket=2, client=ONE, id="a", points=1, commanded=[0], more=True)),
    (1.015, link.ReleaseLease(ticket=3, client=ONE)),
    (1.022, link.ConnectionClosed(client=ONE)),
    (1.030, link.AcquireLease(ticket=4, client=OTHER)),
)
ALL: Heard = {1: True, 2: True, 3: True}


@dataclass
class Daemon:
    """Answers every connection in the order of its calls; a motion takes `late` s longer than recorded."""

    clock: FakeClock
    late: float
    due: list[tuple[float, "Line", Callable[[Reply], None], Reply]] = field(default_factory=list)
    heard: list[tuple[float, str]] = field(default_factory=list)  # when calls came, and hang-ups

    def wait(self, lines: Sequence["Line"], seconds: float) -> None:
        """Until the next answer is there, so long at most."""
        until = self.clock.now() + seconds
        ready = [each for each in self.due if each[0] <= until and each[1].open]
        self.clock.sleep_until(min([until, *(each[0] for each in ready)]))
        for each in [each for each in ready if each[0] <= self.clock.now()]:
            self.due.remove(each)
            _, _, take, reply = each
            take(reply)


class Line:
    """A connection to it."""

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon
        self.open = True
        self._free = 0.0

    def send(
        self, method: str, parameters: Mapping[str, Any], take: Callable[[Reply], None], *, more: bool = False
    ) -> None:
        """A call, answered in its turn."""
        daemon = self._daemon
        now = self._daemon.clock.now()
        if method == "Monitor":
            take(({"status": STATUS, "time": now}, None, True))
            return
        daemon.heard.append((now, method))
        self._free = max(self._free, now) + SOON
        if method == "SubmitTrajectory":
            daemon.due.append((self._free, self, take, ({"phase": "accepted"}, None, True)))
            self._free += MOTION + daemon.late
        said = {"phase": "succeeded"} if method == "SubmitTrajectory" else {}
        daemon.due.append((self._free, self, take, (said, None, False)))

    def close(self) -> None:
        """Hang up."""
        self.open = False
        self._daemon.heard.append((self._daemon.clock.now(), "hung up"))


def played(
    monkeypatch: pytest.MonkeyPatch, late: float, sightings: Heard
) -> tuple[list[str], list[tuple[float, str]]]:
    """Results of the calls, and the received calls with their times (s since the beginning)."""
    clock = FakeClock(500.0)
    daemon = Daemon(clock, late)
    monkeypatch.setattr(replay_client, "ReplayConnection", lambda _: Line(daemon))
    monkeypatch.setattr(replay_client, "wait", daemon.wait)
    asked = tuple(RecordedCommand(BEGIN + time, command, link.pack_path(PATH)) for time, command in SCENE)
    recorded = RunOutcome((), {}, "armed", "live", True)
    score = ReplayScript(
        names=("head_yaw",),
        begin=BEGIN,
        end=BEGIN + 4.0,
        mode="live",
        armed=True,
        holder=0,
        goal=np.zeros(1),
        asked=asked,
        recorded=recorded,
        left_out=(),
        whole=True,
        heard={ONE: sightings},
    )
    passage = ReplayPosition(BEGIN)
    passage.go(clock.now(), BEGIN)
    made = ReplayClient(score, Path("nowhere"), passage, clock).play()
    times = [(time - passage.shift - BEGIN, what) for time, what in daemon.heard]
    return [each.words() for each in made.answers], times


def hung_up(calls: Sequence[tuple[float, str]]) -> float:
    return next(time for time, what in calls if what == "hung up")


@pytest.mark.parametrize("late", [0.0, 0.02, 0.5])
def test_an_answer_that_comes_later_than_recorded_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, late: float
) -> None:
    """A motion ends a little later, and the release of the lease waits behind it: `twindctl move`."""
    answers, heard = played(monkeypatch, late, ALL)
    assert answers == [
        "AcquireLease: done",
        "SubmitTrajectory: succeeded",
        "ReleaseLease: done",
        "AcquireLease: done",
    ]
    assert hung_up(heard) == pytest.approx(1.02 + late, abs=0.02)
    assert [what for _, what in heard][-2:] == ["hung up", "AcquireLease"], "the order is that of then"


def test_a_client_that_left_during_a_motion_does_not_wait_for_its_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    answers, heard = played(monkeypatch, 0.5, {1: True, 2: False})
    assert answers[1:3] == ["SubmitTrajectory: accepted", "ReleaseLease: not answered"]
    assert hung_up(heard) == pytest.approx(1.022, abs=0.005)


def test_an_answer_that_does_not_come_at_all_is_not_waited_for_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    answers, heard = played(monkeypatch, 60.0, ALL)
    assert answers[1:3] == ["SubmitTrajectory: accepted", "ReleaseLease: not answered"]
    assert hung_up(heard) == pytest.approx(1.022 + STAY, abs=0.005)
