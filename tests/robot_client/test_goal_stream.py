"""A stream of goals: the newest goes out, nothing waits for an answer, nothing is lost in silence."""

import threading
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from twind.client import ClientError, Disconnected, Refused
from twind.exceptions import InvalidInput
from twind.robot_client.goal_stream import GoalStream

JOINTS = ("yaw", "pitch")
LIMITS = np.array([4.0, 4.0])


class Daemon:
    """Answers when it is allowed to."""

    def __init__(self, *, open: bool = True, error: ClientError | None = None) -> None:
        self.calls: list[dict[str, Any]] = []
        self.error = error
        self.may_answer = threading.Event()
        self.asked = threading.Event()
        if open:
            self.may_answer.set()

    def __call__(self, **parameters: Any) -> Mapping[str, Any]:
        self.calls.append(parameters)
        self.asked.set()
        assert self.may_answer.wait(10.0)
        if self.error is not None:
            raise self.error
        return {"sequence": len(self.calls), "changes": [], "behind": [0.02, None]}


def stream(daemon: Daemon, **options: Any) -> GoalStream:
    return GoalStream(daemon, JOINTS, LIMITS, 100.0, **options)


def refused() -> Refused:
    finding = {"code": "POS_LIMIT", "joint": "yaw", "message": "yaw: position 9 rad, bound 1 rad"}
    return Refused("io.twind.Control.Refused", {"findings": [finding]})


def test_a_slow_daemon_delays_no_send_and_gets_the_newest_goal() -> None:
    daemon = Daemon(open=False)
    with stream(daemon) as goals:
        goals.send([0.0, 0.0])
        assert daemon.asked.wait(10.0)
        for place in (0.1, 0.2, 0.3):
            goals.send([place, 0.0])
        assert goals.report.superseded == 2
        daemon.may_answer.set()
    assert [call["positions"][0] for call in daemon.calls] == [0.0, 0.3]
    assert (goals.report.sent, goals.report.accepted, goals.report.behind) == (4, 2, {"yaw": 0.02})


def test_goals_that_expire_carry_the_time_until_which_they_may_be_followed() -> None:
    daemon = Daemon()
    with stream(daemon) as goals:
        goals.send([0.0, 0.0])
        assert daemon.asked.wait(10.0)
        goals.expires = True
        before = time.monotonic()
        goals.send([0.1, 0.0])
        after = time.monotonic()
    first, second = (call["valid_until"] for call in daemon.calls)
    assert first is None and before <= second - goals.valid_for <= after


def test_velocities_follow_from_the_goals_and_a_step_is_a_target_to_stop_at() -> None:
    daemon = Daemon()
    with stream(daemon) as goals:
        for place in (0.0, 0.01, 1.01):
            daemon.asked.clear()
            goals.send([place, 0.0])
            assert daemon.asked.wait(10.0)
        goals.send({"pitch": 0.02}, {"pitch": 0.5})
    speeds = [call["velocities"] for call in daemon.calls]
    assert speeds == [[0.0, 0.0], [pytest.approx(1.0), 0.0], [0.0, 0.0], [0.0, 0.5]]
    assert daemon.calls[-1]["positions"] == [1.01, 0.02]


def test_degrees_are_scaled_once() -> None:
    daemon = Daemon()
    with stream(daemon, scale=np.pi / 180.0) as goals:
        goals.send({"yaw": 90.0, "pitch": 0.0}, [180.0, 0.0])
        daemon.asked.wait(10.0)
        goals.send({"pitch": 45.0}, [0.0, 0.0])
    assert daemon.calls[0]["positions"][0] == pytest.approx(np.pi / 2)
    assert daemon.calls[0]["velocities"][0] == pytest.approx(np.pi)
    assert daemon.calls[-1]["positions"] == pytest.approx([np.pi / 2, np.pi / 4])


def test_a_refusal_is_raised_by_the_next_send_or_at_the_end() -> None:
    with pytest.raises(Refused, match="POS_LIMIT"), stream(Daemon(error=refused())) as goals:
        goals.send([9.0, 0.0])
    assert goals.report.refused == 1


def test_a_stream_that_is_not_strict_counts_refusals_but_raises_a_lost_daemon() -> None:
    with stream(Daemon(error=refused()), strict=False) as goals:
        goals.send([9.0, 0.0])
    assert isinstance(goals.report.refusal, Refused)
    with pytest.raises(Disconnected), stream(Daemon(error=Disconnected("gone")), strict=False) as goals:
        goals.send([0.0, 0.0])


def test_who_waits_gets_the_changes_of_the_gate_or_the_refusal() -> None:
    with stream(Daemon(), strict=False) as goals:
        assert list(goals.send_and_wait([0.0, 0.0])) == []
    with stream(Daemon(error=refused()), strict=False) as goals, pytest.raises(Refused):
        goals.send_and_wait([9.0, 0.0])
    assert goals.report.refused == 1


@pytest.mark.parametrize(
    ("goals", "message"),
    [
        ({"yaw": 0.0}, "need every joint of the stream; missing: pitch"),
        ({"yaw": 0.0, "pitch": 0.0, "roll": 1.0}, "roll is not in the stream"),
        ([0.0], r"shape \(1,\)"),
        ([0.0, float("nan")], "pitch: the goal is not finite"),
    ],
)
def test_wrong_goals_are_refused_before_they_are_sent(goals: Any, message: str) -> None:
    daemon = Daemon()
    with stream(daemon) as made, pytest.raises(InvalidInput, match=message):
        made.send(goals)
    assert daemon.calls == []


def test_a_rate_out_of_range_is_refused() -> None:
    with pytest.raises(InvalidInput, match="use 1 to 1000"):
        GoalStream(Daemon(), JOINTS, LIMITS, 0.5)
