"""sd_notify: what the service manager is told, and when, over a real socket."""

import os
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from twind.loop.notify import Notifier


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.setblocking(False)
        yield listener


@pytest.fixture
def told() -> Iterator[Callable[..., Notifier]]:
    """A notifier in an environment, closed afterwards."""
    with ExitStack() as stack:
        yield lambda **environment: stack.enter_context(closing(Notifier(environment)))


def heard(manager: socket.socket) -> list[str]:
    found = []
    while True:
        try:
            found.append(manager.recv(4096).decode())
        except BlockingIOError:
            return found


def test_ready_is_said_once_by_the_first_whole_tick(
    manager: socket.socket, told: Callable[..., Notifier]
) -> None:
    notifier = told(NOTIFY_SOCKET=manager.getsockname())
    assert heard(manager) == []
    for tick in range(5):
        notifier.alive(0.01 * tick)
    assert heard(manager) == ["READY=1"]


def test_the_watchdog_is_fed_four_times_an_interval_while_ticks_are_whole(
    manager: socket.socket, told: Callable[..., Notifier]
) -> None:
    interval, address = "2000000", manager.getsockname()
    notifier = told(NOTIFY_SOCKET=address, WATCHDOG_USEC=interval, WATCHDOG_PID=str(os.getpid()))
    for tick in range(200):  # 1.99 s
        notifier.alive(0.01 * tick)
    assert heard(manager) == ["READY=1", *["WATCHDOG=1"] * 4]


def test_a_watchdog_meant_for_another_process_is_not_fed(
    manager: socket.socket, told: Callable[..., Notifier]
) -> None:
    interval, address = "2000000", manager.getsockname()
    notifier = told(NOTIFY_SOCKET=address, WATCHDOG_USEC=interval, WATCHDOG_PID=str(os.getpid() + 1))
    notifier.alive(0.0)
    notifier.alive(5.0)
    assert heard(manager) == ["READY=1"]


def test_a_manager_that_is_gone_costs_nothing(tmp_path: Path, told: Callable[..., Notifier]) -> None:
    notifier = told(NOTIFY_SOCKET=str(tmp_path / "nobody"))
    notifier.alive(0.0)
    notifier.send(STOPPING="1")
