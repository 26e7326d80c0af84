"""Clients at a real daemon over its real socket: what they saw is explained by one order of events."""

import os
import random
from collections.abc import Iterator

import pytest

from tests.proof.model.live import Workload
from tests.support.live_robot import LiveRobot, live_robot
from tests.support.processes import BUSY, arm

SECONDS = float(os.environ.get("MODEL_SECONDS", "3"))


@pytest.fixture(scope="module")
def live() -> Iterator[LiveRobot]:
    with live_robot() as made:
        yield made


@pytest.mark.parametrize("kill_front", [False, True])
def test_a_history_over_the_socket_has_one_order(live: LiveRobot, kill_front: bool) -> None:
    seed = int(os.environ.get("MODEL_SEED", random.randrange(1 << 32)))
    print(f"MODEL_SEED={seed}")
    live.ready()
    with live.running.client() as client:
        arm(client)
    workload = Workload(live.running, seed)
    workload.run(SECONDS, kill_front=kill_front)
    history = workload.history
    assert not history.wrong(), "\n".join(history.wrong()[:10])
    assert not workload.gaps
    status = live.running.reach(armed=True)
    assert {each["code"] for each in status["faults"]} <= BUSY, status["faults"]
    done = [op for op in history.ops if op.ok]
    spans = history.spans()
    print(f"{len(history.ops)} calls, {len(done)} obeyed, {len(spans)} leases, {workload.events} events")
    assert len(done) > 10
    assert len({span.client for span in spans}) > 1
    assert any(op.motion for op in done)
    assert any(op.result == "LeaseHeld" for op in history.ops)
