"""The viewer's stop buttons: whatever hangs, answers rubbish or may not be asked."""

import queue
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.daemon_stand_ins import Daemons, answering, next_outcome
from twind.observe.viewing.robot_connections import local
from twind.observe.viewing.stop_threads import StopOutcome, StopThreads


@pytest.fixture
def daemons(tmp_path: Path) -> Iterator[Daemons]:
    with answering(tmp_path) as make:
        yield make


def test_an_estop_waits_for_no_stop_that_hangs(daemons: Daemons, tmp_path: Path) -> None:
    daemons("control", lambda method: None)
    daemons("observe", lambda method: {"parameters": {"state": "estop", "torque_off": True, "done": True}})
    stops = StopThreads(local(str(tmp_path)), bound=1.0)
    stop = queue.Queue()
    estop = queue.Queue()
    stops.stop.ask(stop.put)
    stops.estop.ask(estop.put)
    assert next_outcome(estop, 0.9) == StopOutcome(True, "e-stop", "state estop, torque is off")
    assert stop.empty()
    late = next_outcome(stop)
    assert not late.done
    assert "no answer from the daemon within 1 s" in late.text


def test_an_e_stop_uses_any_available_socket_and_reports_when_there_is_none(
    daemons: Daemons, tmp_path: Path
) -> None:
    stops = StopThreads(local(str(tmp_path)), bound=1.0)
    outcomes = queue.Queue()
    stops.estop.ask(outcomes.put)
    none = next_outcome(outcomes)
    assert (none.done, none.title) == (False, "e-stop NOT confirmed") and "own switch" in none.text
    control = daemons("control", lambda method: {"parameters": {"state": "estop", "torque_off": None}})
    stops.estop.ask(outcomes.put)
    assert next_outcome(outcomes).done
    assert control.asked == ["EStop"]


@pytest.mark.parametrize("observe", [{"parameters": {}}, {"error": 7}, {"error": "x.y.Busy"}, [1]])
def test_an_e_stop_uses_the_other_socket_after_an_invalid_reply(
    daemons: Daemons, tmp_path: Path, observe: Any
) -> None:
    daemons("observe", lambda method: observe)
    daemons("control", lambda method: {"parameters": {"state": "estop", "torque_off": False}})
    outcomes: queue.Queue[StopOutcome] = queue.Queue()
    StopThreads(local(str(tmp_path)), bound=1.0).estop.ask(outcomes.put)
    assert next_outcome(outcomes) == StopOutcome(True, "e-stop", "state estop, torque is on")


def test_a_stop_button_survives_invalid_replies_and_unreachable_tabs(
    daemons: Daemons, tmp_path: Path
) -> None:
    answers: dict[str, Any] = {"Cancel": {"parameters": {}}, "EStop": {"parameters": {"torque_off": 7}}}
    daemons("control", answers.get)
    stops = StopThreads(local(str(tmp_path)), bound=1.0)
    outcomes = queue.Queue()

    def no_tab(outcome: StopOutcome) -> None:
        raise RuntimeError("the tab was closed")

    for errand in (stops.stop, stops.estop):
        errand.ask(no_tab)
        errand.ask(outcomes.put)
        failed = next_outcome(outcomes)
        assert not failed.done and failed.title == f"{errand.name} NOT confirmed"
        assert "use its own switch" in failed.text
    answers |= {method: {"parameters": {"state": "estop"}} for method in answers}
    for errand in (stops.stop, stops.estop):
        errand.ask(outcomes.put)
        assert next_outcome(outcomes).done


def test_a_refused_stop_names_the_e_stop_as_alternative(daemons: Daemons, tmp_path: Path) -> None:
    refusal = {
        "error": "io.twind.Control.NotAllowed",
        "parameters": {"role": "observer", "method": "Cancel"},
    }
    daemons("control", lambda method: refusal)
    outcomes: queue.Queue[StopOutcome] = queue.Queue()
    StopThreads(local(str(tmp_path))).stop.ask(outcomes.put)
    answer = next_outcome(outcomes)
    assert not answer.done and "e-stop needs no operator" in answer.text
