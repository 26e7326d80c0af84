"""The process of the gap starts where its figures mean something, and nowhere else."""

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twind.exceptions import InvalidInput
from twind.front import gap_monitor
from twind.front.gap_monitor import AGAIN, SETTLED, STALE, GapMonitor
from twind.observe.measuring.measured_motion import require_sent_goals


class CountedStarts:
    """A front process whose executor only counts."""

    def __init__(self, parameters: dict[str, Any], description: dict[str, Any]) -> None:
        self.starts = 0
        briefing = SimpleNamespace(
            parameters=parameters, description=description, binding=b"x", rate_hz=100.0
        )
        self.world = SimpleNamespace(briefing=briefing, gap=None)
        self.loop = self

    def now(self) -> float:
        return 100.0

    def run_in_executor(self, *_: object) -> Any:
        self.starts += 1
        return SimpleNamespace(add_done_callback=lambda _: None)


@pytest.mark.parametrize(
    ("mode", "armed", "parameters", "compensated", "starts"),
    [
        ("live", True, {}, False, 1),
        ("sim", True, {}, False, 0),
        ("live", False, {}, False, 0),
        ("live", True, {"gap": False}, False, 0),
        ("live", True, {}, True, 0),
    ],
)
def test_it_starts_for_goals_that_reached_a_robot_as_they_are(
    mode: str, armed: bool, parameters: dict[str, Any], compensated: bool, starts: int
) -> None:
    front = CountedStarts(parameters, {"compensate_gravity": compensated})
    monitor = GapMonitor(front)  # type: ignore[arg-type]
    for time in (0.0, SETTLED + 0.1):
        monitor.tick(SimpleNamespace(mode=mode, armed=armed, time=time))  # type: ignore[arg-type]
    assert front.starts == starts


class SocketFront:
    """A front process in an event loop. The test is the process of the gap, at the other end of `theirs`."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.time = 100.0
        briefing = SimpleNamespace(parameters={}, description={}, binding=b"x", rate_hz=100.0)
        self.world = SimpleNamespace(briefing=briefing, gap=None)
        self.told: list[str] = []
        self.logged: list[str] = []
        self.telemetry = SimpleNamespace(event=lambda event: self.told.append(event.code))
        self.log = SimpleNamespace(write=lambda _level, code, _time, **_: self.logged.append(code))
        self.killed = 0
        self.started = 0

    def now(self) -> float:
        return self.time

    def begin(self, *_: object) -> Any:
        ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        self.theirs.setblocking(False)
        self.started += 1
        return SimpleNamespace(kill=self.kill, wait=lambda: 0), ours

    def kill(self) -> None:
        self.killed += 1

    def received(self) -> bytes:
        """Return the next sample; empty: none."""
        try:
            return self.theirs.recv(1 << 16)
        except BlockingIOError:
            return b""

    def news(self, time: float) -> Any:
        column = np.array([time, 0.5]).tobytes()
        numbers = dict.fromkeys(("goal", "position", "velocity", "effort"), column)
        return SimpleNamespace(mode="live", armed=True, time=time, **numbers)


async def attached(front: SocketFront, monitor: GapMonitor) -> None:
    """Let the robot be armed until samples arrive at the other end."""
    started = front.started
    monitor.tick(front.news(0.0))
    monitor.tick(front.news(SETTLED + 0.1))
    while front.started == started or not front.received():
        await asyncio.sleep(0.001)
        monitor.tick(front.news(SETTLED + 0.2))
    while front.received():
        pass


def watched(check: Callable[[SocketFront, GapMonitor], Awaitable[None]], patch: pytest.MonkeyPatch) -> None:
    """Run `check` in an event loop."""

    async def run() -> None:
        front = SocketFront(asyncio.get_running_loop())
        patch.setattr(gap_monitor, "_begin", front.begin)
        monitor = GapMonitor(front)  # type: ignore[arg-type]
        try:
            await check(front, monitor)
        finally:
            monitor.close()
            front.theirs.close()

    asyncio.run(asyncio.wait_for(run(), 20.0))


def test_samples_go_out_and_figures_come_in_until_they_are_old(monkeypatch: pytest.MonkeyPatch) -> None:
    async def check(front: SocketFront, monitor: GapMonitor) -> None:
        await attached(front, monitor)
        monitor.tick(front.news(20.0))
        assert np.frombuffer(front.received()).tolist() == [20.0, *[20.0, 0.5] * 4]
        grown = [{"joint": "knee", "quantity": "effort", "value": 0.3, "bound": 0.2}]
        front.theirs.send(json.dumps({"gap": {"joints": []}, "grown": grown}).encode())
        while front.world.gap is None:
            await asyncio.sleep(0.001)
        assert front.told == front.logged == ["GAP_GROWN"]
        monitor.housekeep(front.time + STALE)
        assert front.world.gap == {"joints": []}
        monitor.housekeep(front.time + STALE + 0.1)
        assert front.world.gap is None
        for tick in range(10_000):  # more than the socket holds
            monitor.tick(front.news(21.0 + tick / 100.0))
        assert not front.killed and front.told == ["GAP_GROWN"]
        monitor.close()
        assert front.killed == 1

    watched(check, monkeypatch)


@pytest.mark.parametrize("noticed", ["sending", "receiving"])
def test_a_process_that_ended_is_reported_once_and_started_again_later(
    monkeypatch: pytest.MonkeyPatch, noticed: str
) -> None:
    async def check(front: SocketFront, monitor: GapMonitor) -> None:
        for life in (1, 2):
            await attached(front, monitor)
            front.theirs.close()
            if noticed == "sending":
                monitor.tick(front.news(20.0))
            while front.killed < life:
                await asyncio.sleep(0.001)
            monitor.tick(front.news(30.0))
            await asyncio.sleep(0.01)
            assert front.started == life  # too soon
            front.time += AGAIN
        assert front.told == front.logged == ["GAP_STOPPED"]  # until figures come again

    watched(check, monkeypatch)


def test_a_recording_with_goals_that_were_not_sent_so_is_refused() -> None:
    with pytest.raises(InvalidInput, match="compensate_gravity"):
        require_sent_goals({"compensate_gravity": True})
    require_sent_goals({"compensate_gravity": False})
    require_sent_goals(None)
