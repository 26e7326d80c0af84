"""The reins: what is given up at the end is what is ours, and nothing else."""

from typing import Any

import numpy as np
import pytest

from twind.client import NoAnswer, Refused
from twind.learn.live.setpoint_session import SetpointSession
from twind.learn.policy.policy_card import RATES
from twind.robot_client.control_timing import LONGEST


class Line:
    """A client that notes what is asked of it; `broken` ends its connection at the next call."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.connected = False
        self.broken = ""
        self.timeout = 1.0
        self.open = self.refuses = False  # an answer is awaited; what it says

    def call(self, method: str, **_parameters: Any) -> dict[str, Any]:
        self.asked.append(method)
        self.connected = not self.broken
        if self.broken:
            raise NoAnswer(self.broken)
        return {}

    def begin(self, method: str, **_parameters: Any) -> None:
        assert not self.open
        self.asked.append(method)
        self.connected = self.open = True

    def finish(self) -> None:
        answered = self.open
        self.open = False
        if answered:
            self.asked.append("answer")
            if self.refuses:
                raise Refused("io.twind.Control.Refused", {"findings": []})

    def close(self) -> None:
        self.connected = False


@pytest.fixture
def line() -> Line:
    return Line()


def session_on(line: Line) -> SetpointSession:
    made = SetpointSession(line, ["hip"], 0.02)  # type: ignore[arg-type]
    line.asked.clear()
    return made


def test_the_lease_is_released_once_and_no_motion_is_stopped(line: Line) -> None:
    held = session_on(line)
    held.drop()
    held.drop()
    assert line.asked == ["ReleaseLease"] and not line.connected


def test_a_session_that_lost_its_connection_opens_no_other_to_release_the_lease(line: Line) -> None:
    held = session_on(line)
    line.broken = "the daemon was stopped"
    with pytest.raises(NoAnswer):
        held.keep()
    line.broken = ""
    line.asked.clear()
    held.drop()
    assert line.asked == []


def test_a_daemon_that_is_silent_at_the_end_is_hung_up_on(line: Line) -> None:
    held = session_on(line)
    line.broken = "no answer"
    held.drop()
    assert line.asked == ["ReleaseLease"] and not line.connected


@pytest.mark.parametrize(("rate", "most"), [(100.0, 1), (50.0, 1), (30.0, 1), (20.0, 0), (12.5, 0)])
def test_a_setpoint_outlives_so_many_missed_periods(line: Line, rate: float, most: int) -> None:
    held = SetpointSession(line, ["hip"], 1.0 / rate)  # type: ignore[arg-type]
    assert not held.lapses(most) and held.lapses(most + 1)


def test_the_slowest_card_leaves_a_setpoint_two_ticks_of_the_slowest_loop_to_be_followed_by_the_next() -> (
    None
):
    assert 1.0 / RATES[0] + 2 * 0.01 <= LONGEST + 1e-9


def test_the_answer_to_a_setpoint_is_taken_with_the_next_call(line: Line) -> None:
    held = session_on(line)
    place = np.zeros(1)
    held.send(place, place)
    held.send(place, place)
    held.keep()
    held.drop()
    assert line.asked == ["Setpoint", "answer", "Setpoint", "answer", "RenewLease", "ReleaseLease"]


def test_a_setpoint_after_one_that_was_refused_is_not_sent(line: Line) -> None:
    held = session_on(line)
    place = np.zeros(1)
    held.send(place, place)
    line.refuses = True
    with pytest.raises(Refused):
        held.send(place, place)
    assert line.asked == ["Setpoint", "answer"]


def test_a_waiting_send_receives_the_refusal_at_once(line: Line) -> None:
    held = session_on(line)
    place = np.zeros(1)
    line.refuses = True
    with pytest.raises(Refused):
        held.send(place, place, wait=True)


def test_a_refused_last_setpoint_does_not_prevent_the_release_of_the_lease(line: Line) -> None:
    held = session_on(line)
    place = np.zeros(1)
    held.send(place, place)
    line.refuses = True
    held.drop()
    assert line.asked == ["Setpoint", "answer", "ReleaseLease"]
