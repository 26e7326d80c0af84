"""Lanes: one thing after the other, a bounded number, and who is too many is told at once."""

import threading
import time

from tests.support.processes import until
from twind.bridge.uplink.worker_queue import WorkerQueue


def test_jobs_run_in_order_and_those_without_room_are_refused_and_counted() -> None:
    lane = WorkerQueue("asking", length=3)
    done = list[int]()
    gate = threading.Event()
    assert lane.put(gate.wait)
    for number in range(2):
        assert lane.put(lambda number=number: done.append(number))  # type: ignore[misc]
    assert not lane.put(lambda: done.append(99)) and lane.full == 1
    lane.start()
    gate.set()
    until(lambda: lane.done == 3, 10.0, "all is done")
    lane.stop()
    assert done == [0, 1]


def test_the_maintenance_callback_runs_after_each_job_and_when_idle() -> None:
    tended = list[float]()
    lane = WorkerQueue("goals", tend=lambda: tended.append(time.monotonic()), period=0.02)
    lane.start()
    until(lambda: len(tended) > 3, 10.0, "it tends by itself")
    lane.stop()
    count = len(tended)
    time.sleep(0.1)
    assert len(tended) == count, "after the end it tends no more"


def test_a_blocked_worker_queue_does_not_prevent_the_end_of_the_process() -> None:
    gate = threading.Event()
    last = list[str]()
    lane = WorkerQueue("settling", last=lambda: last.append(threading.current_thread().name))
    lane.put(gate.wait)
    lane.start()
    begun = time.monotonic()
    lane.stop(0.1)
    assert time.monotonic() - begun < 5.0
    assert not last, "what ends it is for its own thread: another may be in the midst of it"
    gate.set()
    until(lambda: last == ["settling"], 10.0, "it ends what it did")
