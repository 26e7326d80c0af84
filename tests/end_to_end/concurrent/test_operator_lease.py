"""The lease of the viewer: one tab holds it, as long as the tab answers."""

import queue
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.daemon_stand_ins import Daemons, answering, next_outcome
from twind.observe.viewing.operator_lease import OperatorThread, arm, look_after
from twind.observe.viewing.stop_threads import StopOutcome

LEASE = {"holder": "uid 0, pid 1", "uid": 0, "expires_in": 1.0}


@pytest.fixture
def daemons(tmp_path: Path) -> Iterator[Daemons]:
    with answering(tmp_path) as make:
        yield make


def test_the_lease_is_one_tabs_and_ends_with_it(daemons: Daemons, tmp_path: Path) -> None:
    daemon = daemons("control", lambda method: {"parameters": {"joints": []}})
    holders: queue.Queue[int | None] = queue.Queue()
    operator = OperatorThread(str(tmp_path), holders.put)
    outcomes = queue.Queue()
    operator.call(1, arm, outcomes.put)
    assert not next_outcome(outcomes).done  # nobody took it
    assert daemon.asked == []
    operator.take(1, outcomes.put)
    assert next_outcome(outcomes).title == "lease taken"
    assert holders.get(timeout=5.0) == 1
    operator.take(2, outcomes.put)
    assert not next_outcome(outcomes).done
    operator.call(2, arm, outcomes.put)
    assert not next_outcome(outcomes).done
    assert "Arm" not in daemon.asked
    operator.call(1, arm, outcomes.put)
    assert next_outcome(outcomes).title == "armed"
    operator.on_tab_closed(1)
    assert holders.get(timeout=5.0) is None
    assert daemon.ended.get(timeout=5.0) == "closed"
    assert {"AcquireLease", "RenewLease"} <= set(daemon.asked)


def test_a_request_during_a_running_call_is_refused_and_never_run_later(
    daemons: Daemons, tmp_path: Path
) -> None:
    going_on = threading.Event()
    begun = threading.Event()

    def answers(method: str) -> Any:
        if method == "Arm":
            begun.set()
            going_on.wait(5.0)
        return {"parameters": {"joints": []}}

    daemon = daemons("control", answers)
    operator = OperatorThread(str(tmp_path), lambda tab: None)
    outcomes = queue.Queue()
    operator.take(1, outcomes.put)
    assert next_outcome(outcomes).done
    operator.call(1, arm, outcomes.put)
    assert begun.wait(5.0)
    operator.call(1, lambda client: StopOutcome(True, "played", ""), outcomes.put)
    assert next_outcome(outcomes).text == "what was asked before is still being done"
    going_on.set()
    assert next_outcome(outcomes).title == "armed"
    assert outcomes.empty() and daemon.asked.count("Arm") == 1


def test_a_page_that_does_not_answer_loses_the_lease(daemons: Daemons, tmp_path: Path) -> None:
    daemon = daemons("control", lambda method: {"parameters": {}})
    operator = OperatorThread(str(tmp_path), lambda tab: None)
    outcomes = queue.Queue()
    operator.take(1, outcomes.put)
    assert next_outcome(outcomes).done
    answers = iter([RuntimeError("it may not read what it keeps"), TimeoutError("nothing came")])

    def ask() -> None:
        raise next(answers)

    look_after(operator, 1, ask)
    assert daemon.ended.get(timeout=5.0) == "closed"
    operator.take(1, outcomes.put)  # it came back, and asks anew
    assert next_outcome(outcomes).done


def test_a_lease_that_was_lost_is_not_taken_again_by_itself(daemons: Daemons, tmp_path: Path) -> None:
    lost = {"error": "io.twind.Control.Refused", "parameters": {"findings": []}}
    daemon = daemons("control", lambda method: lost if method == "RenewLease" else {"parameters": {}})
    holders: queue.Queue[int | None] = queue.Queue()
    operator = OperatorThread(str(tmp_path), holders.put)
    outcomes = queue.Queue()
    operator.take(1, outcomes.put)
    assert [holders.get(timeout=5.0), holders.get(timeout=5.0)] == [1, None]
    assert daemon.asked == ["AcquireLease", "RenewLease"]


def test_a_completed_call_is_reported_even_if_the_lease_is_lost_afterwards(
    daemons: Daemons, tmp_path: Path
) -> None:
    armed = threading.Event()
    other = {"error": "io.twind.Control.LeaseHeld", "parameters": {"lease": LEASE}}

    def answers(method: str) -> Any:
        if method == "Arm":
            armed.set()
        taken = armed.is_set() and method == "AcquireLease"
        return other if taken else {"parameters": {"joints": []}}

    daemons("control", answers)
    holders: queue.Queue[int | None] = queue.Queue()
    operator = OperatorThread(str(tmp_path), holders.put)
    outcomes = queue.Queue()
    operator.take(1, outcomes.put)
    assert next_outcome(outcomes).done
    operator.call(1, arm, outcomes.put)
    outcome = next_outcome(outcomes)
    assert (outcome.done, outcome.title) == (True, "armed")
    assert "the lease is gone: the lease is held by uid 0" in outcome.text
    assert [holders.get(timeout=5.0), holders.get(timeout=5.0)] == [1, None]


def test_an_invalid_reply_fails_only_its_own_call(daemons: Daemons, tmp_path: Path) -> None:
    daemons("control", lambda method: {"parameters": {}})  # Arm says no joints
    operator = OperatorThread(str(tmp_path), lambda tab: None)
    outcomes = queue.Queue()
    operator.take(1, outcomes.put)
    assert next_outcome(outcomes).done
    operator.call(1, arm, outcomes.put)
    assert next_outcome(outcomes).title == "NOT confirmed"
    operator.give(1, outcomes.put)
    assert next_outcome(outcomes).title == "lease given back"


def test_a_page_that_cannot_be_asked_loses_the_lease(daemons: Daemons, tmp_path: Path) -> None:
    daemon = daemons("control", lambda method: {"parameters": {}})
    operator = OperatorThread(str(tmp_path), lambda tab: None)
    outcomes = queue.Queue()
    operator.take(1, outcomes.put)
    assert next_outcome(outcomes).done
    look_after(operator, 1, lambda: {}["no such page"])
    assert daemon.ended.get(timeout=5.0) == "closed"
