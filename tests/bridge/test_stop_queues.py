"""Stops from elsewhere: behind no other request, each with an answer, an e-stop by every way that exists."""

import threading
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from tests.support.processes import until
from tests.support.scripted_line import ScriptedDaemon
from twind.bridge.commands import stop_queues
from twind.bridge.commands.control_socket_access import denied
from twind.bridge.commands.stop_queues import CUT, HOLD, SETTLE, Outcome, StopQueues
from twind.client import ClientError


class Asked:
    """Request with the outcomes that it got."""

    def __init__(self, **parameters: Any) -> None:
        self.parameters: Mapping[str, Any] = parameters
        self.outcomes = list[Outcome]()

    def reply(self, outcome: Outcome) -> None:
        self.outcomes.append(outcome)
        if self.parameters.get("reason") == "gone":
            raise BrokenPipeError("nobody reads it")


class Desk:
    """Stop queues and their daemon; `closed`: why no hold is taken."""

    def __init__(self) -> None:
        self.daemon = ScriptedDaemon()
        self.observing = ScriptedDaemon()
        self.stopped = list[float]()
        self.lines = list[str]()
        self.closed = ""
        self.stops = StopQueues(
            self.daemon.client,
            self.observing.client,
            self.stopped.append,
            self.lines.append,
            closed=lambda: self.closed,
        )

    def stop(self, kind: str, **parameters: Any) -> Outcome:
        asked = Asked(**parameters)
        assert self.stops.put(kind, asked)
        until(lambda: asked.outcomes, 10.0, "an outcome")
        return asked.outcomes[0]


@pytest.fixture
def desk() -> Iterator[Desk]:
    made = Desk()
    for queue in made.stops.queues.values():
        queue.start()
    yield made
    for queue in made.stops.queues.values():
        queue.stop()


def test_a_stop_is_recorded_before_and_after_its_call(desk: Desk) -> None:
    seen = list[int]()
    desk.daemon.meanwhile = lambda method: seen.append(len(desk.stopped))
    assert desk.stop(HOLD) == {"state": "armed"}
    assert seen == [1] and len(desk.stopped) == 2


@pytest.mark.parametrize("kind", [SETTLE, CUT])
def test_an_e_stop_takes_the_other_connection_where_the_first_fails(desk: Desk, kind: str) -> None:
    desk.observing.refuse["EStop"] = ("Busy", {"what": "all places are taken"})
    assert desk.stop(kind, reason="test") == {"state": "estop", "done": True}
    assert desk.daemon.named("EStop") == [{"level": kind, "reason": "test"}]
    desk.observing.absent = desk.daemon.absent = True
    assert str(desk.stop(kind)) == "nobody listens"


def test_a_closed_desk_refuses_a_hold_and_no_e_stop(desk: Desk) -> None:
    desk.closed = "it only looks"
    refused = desk.stop(HOLD)
    assert isinstance(refused, ClientError) and str(refused) == "it only looks"
    assert not desk.daemon.calls and not desk.stopped
    assert desk.stop(SETTLE) == {"state": "estop", "done": True}


@pytest.mark.parametrize("hung", [SETTLE, HOLD])
def test_a_cut_waits_for_no_other_stop(desk: Desk, hung: str) -> None:
    begun = threading.Event()
    go_on = threading.Event()

    def hang(method: str) -> None:
        if not begun.is_set():
            begun.set()
            go_on.wait(20.0)

    desk.daemon.meanwhile = desk.observing.meanwhile = hang
    first = Asked()
    desk.stops.put(hung, first)
    assert begun.wait(10.0)
    try:
        assert desk.stop(CUT) == {"state": "estop", "done": True}
        assert not first.outcomes
    finally:
        go_on.set()
    until(lambda: first.outcomes, 10.0, "the other one")


def test_each_of_a_flood_gets_an_answer_and_one_that_cannot_be_sent_withholds_no_other(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = [Asked(reason="gone" if number == 7 else "x") for number in range(300)]
    assert all(desk.stops.put(SETTLE, each) for each in asked)
    until(lambda: all(each.outcomes for each in asked), 10.0, "all answers")
    assert len(desk.observing.named("EStop")) < 300
    until(lambda: desk.lines == ["settle: BrokenPipeError: nobody reads it"], 10.0, "a line")


def test_a_stop_without_room_is_made_and_a_waiting_one_is_not_queued_again() -> None:
    desk = Desk()
    first = Asked()
    many = [Asked() for _ in range(stop_queues.WAITING - 1)]
    assert all(desk.stops.put(CUT, each) for each in (first, first, *many))
    assert not desk.stops.put(CUT, Asked())
    desk.stops.queues[CUT].start()
    until(lambda: many[-1].outcomes, 10.0, "the answers")
    assert len(first.outcomes) == 1 and len(desk.observing.named("EStop")) == 1


def test_a_missing_permission_is_detected_by_a_call_without_effect() -> None:
    daemon = ScriptedDaemon()
    assert denied(daemon.client) == ""
    daemon.refuse["ReleaseLease"] = ("NotAllowed", {"method": "ReleaseLease", "role": "observer"})
    assert "not for the role observer" in str(denied(daemon.client))
    daemon.refuse["ReleaseLease"] = ("Busy", {"what": "all places"})
    assert denied(daemon.client) is None
    daemon.absent = True
    assert denied(daemon.client) is None
