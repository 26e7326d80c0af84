"""A stop that many ask for: one call for all who wait, and none of them is turned away."""

import threading
from typing import Any

from tests.support.processes import until
from twind.bridge.uplink.coalesced_stop import WAITING, CoalescedStop
from twind.bridge.uplink.query_server import Outcome, Serve
from twind.client import NoDaemon


class Asked:
    """One who waits."""

    def __init__(self, **asked: Any) -> None:
        self.asked = asked
        self.replies = list[Outcome]()
        self.forgotten = False

    def outcome(self, serve: Serve) -> Outcome:
        try:
            return serve(self.asked)
        except NoDaemon as error:
            return {"error": str(error)}

    def reply(self, outcome: Outcome) -> None:
        self.replies.append(outcome)

    def forget(self) -> None:
        self.forgotten = True


def test_all_who_wait_are_answered_by_one_call_and_who_comes_meanwhile_by_the_next() -> None:
    calls = list[Any]()
    begun = threading.Event()
    gate = threading.Event()

    def stop(asked: dict[str, Any]) -> dict[str, Any]:
        calls.append(asked)
        begun.set()
        assert gate.wait(10.0)
        return {"call": len(calls)}

    together = CoalescedStop("cutting", stop)
    first = Asked(reason="first")
    assert together.put(first)  # type: ignore[arg-type]
    together.start()
    assert begun.wait(10.0)
    others = [Asked(reason=str(number)) for number in range(50)]
    assert all(together.put(each) for each in others)  # type: ignore[arg-type]
    gate.set()
    until(lambda: together.done == 51, 10.0, "everybody has an answer")
    together.stop()
    assert first.replies == [{"call": 1}]
    assert all(each.replies == [{"call": 2}] for each in others)
    assert calls == [{"reason": "first"}, {"reason": "0"}] and together.full == 0


def test_excess_stop_requests_drop_the_oldest_waiters_and_the_stop_is_still_made() -> None:
    together = CoalescedStop("settling", lambda asked: {"state": "estop"})
    many = [Asked() for _ in range(WAITING + 3)]
    assert all(together.put(each) for each in many)  # type: ignore[arg-type]
    assert [each.forgotten for each in many] == [True] * 3 + [False] * WAITING
    together.start()
    until(lambda: together.done == WAITING, 10.0, "who waits has an answer")
    together.stop()
    assert together.full == 3 and many[-1].replies == [{"state": "estop"}]


def test_a_failed_stop_call_is_reported_to_all_waiters_and_the_next_is_made() -> None:
    answers = iter([NoDaemon("away"), {"state": "estop"}])

    def stop(asked: dict[str, Any]) -> dict[str, Any]:
        answer = next(answers)
        if isinstance(answer, NoDaemon):
            raise answer
        return answer

    together = CoalescedStop("settling", stop)
    first = Asked()
    second = Asked()
    together.put(first)  # type: ignore[arg-type]
    together.start()
    until(lambda: together.done == 1, 10.0, "the first")
    together.put(second)  # type: ignore[arg-type]
    until(lambda: together.done == 2, 10.0, "the second")
    together.stop()
    assert first.replies == [{"error": "away"}] and second.replies == [{"state": "estop"}]
