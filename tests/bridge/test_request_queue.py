"""Queue of requests: in order, a bounded number, and none prevents the next."""

import threading
from collections.abc import Sequence

from tests.support.processes import until
from twind.bridge.commands.request_queue import RequestQueue


def test_requests_are_served_in_order_and_one_without_room_is_refused_and_counted() -> None:
    served = list[int]()
    gate = threading.Event()

    def serve(requests: Sequence[int]) -> None:
        gate.wait(10.0)
        served.extend(requests)

    queue = RequestQueue[int]("asking", serve, print, length=3)
    assert [queue.put(number) for number in range(4)] == [[], [], [], None]
    assert queue.refused == 1
    queue.start()
    gate.set()
    until(lambda: queue.answered == 3, 10.0, "all are served")
    queue.stop()
    assert served == [0, 1, 2]


def test_a_full_queue_of_the_newest_drops_the_oldest_and_serves_the_chosen_first() -> None:
    served = list[Sequence[int]]()
    queue = RequestQueue[int](
        "motions",
        served.append,
        print,
        length=3,
        pace=0.0,
        newest=True,
        choose=lambda waiting: [max(waiting)],
    )
    assert [queue.put(number) for number in (1, 4, 3, 2)] == [[], [], [], [1]]
    assert queue.remove(lambda waiting: waiting == 3) == [3]
    queue.start()
    until(lambda: queue.answered == 2, 10.0, "both are served")
    queue.stop()
    assert served == [[4], [2]]


def test_requests_that_wait_together_are_served_by_one_call_and_later_ones_by_the_next() -> None:
    calls = list[Sequence[int]]()
    begun = threading.Event()
    gate = threading.Event()

    def serve(requests: Sequence[int]) -> None:
        calls.append(requests)
        begun.set()
        assert gate.wait(10.0)

    queue = RequestQueue[int]("stops", serve, print, choose=list)
    queue.put(0)
    queue.start()
    assert begun.wait(10.0)
    for number in range(1, 51):
        queue.put(number)
    gate.set()
    until(lambda: queue.answered == 51, 10.0, "all are served")
    queue.stop()
    assert calls == [[0], list(range(1, 51))]


def test_a_call_that_raises_is_reported_and_the_next_is_made() -> None:
    lines = list[str]()

    def tell(line: str) -> None:
        lines.append(line)
        raise BrokenPipeError("nobody reads it")

    queue = RequestQueue[float]("dividing", lambda numbers: print(1.0 / numbers[0]), tell, pace=0.0)
    queue.put(0.0)
    queue.put(1.0)
    queue.start()
    until(lambda: queue.answered == 2, 10.0, "both")
    queue.stop()
    assert lines == ["dividing: ZeroDivisionError: float division by zero"]


def test_a_queue_is_tended_after_each_request_and_without_requests_until_it_ends() -> None:
    tended = list[str]()
    queue = RequestQueue[int](
        "goals",
        lambda requests: tended.append("request"),
        print,
        tend=lambda: tended.append("tended"),
        period=0.01,
        last=lambda: tended.append("last"),
    )
    queue.put(1)
    queue.start()
    until(lambda: len(tended) > 4, 10.0, "it is tended")
    queue.stop()
    until(lambda: tended[-1] == "last", 10.0, "the end")
    assert tended[:3] == ["request", "tended", "tended"] and "last" not in tended[:-1]


def test_a_queue_whose_call_hangs_is_left_behind_at_the_end() -> None:
    gate = threading.Event()
    last = list[str]()
    end = threading.Event()

    def serve(requests: Sequence[int]) -> None:
        gate.wait(10.0)

    def ended() -> None:
        last.append(threading.current_thread().name)
        end.set()

    queue = RequestQueue[int]("settling", serve, print, last=ended)
    queue.put(1)
    queue.start()
    queue.stop(0.05)
    assert not last, "its own thread ends it: another may be in the midst of a call"
    gate.set()
    assert end.wait(10.0) and last == ["settling"]
