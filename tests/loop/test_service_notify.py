"""Messages to the service manager over a real datagram socket: ready, alive, the status, the end."""

import os
from collections.abc import Iterator
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import pytest

from tests.support.daemon_rig import Rig
from tests.support.described_robot import redescribe
from tests.support.service_notify_rig import Manager
from twind.link import EStop, Reset
from twind.loop.procedures.lowering import LETTING_GO
from twind.loop.process.service_notify import STATUS, Notifier

FAR = str(os.getpid() + 1)


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Manager]:
    address = str(tmp_path / "notify") if request.param == "path" else f"@twind-test-{os.getpid()}"
    manager = Manager(address)
    yield manager
    manager.socket.close()


@pytest.fixture
def close(request: pytest.FixtureRequest) -> Iterator[Any]:
    """Close what a notifier opened: the daemon keeps its own until it ends."""
    opened: list[Notifier] = []
    yield lambda notifier: opened.append(notifier) or notifier
    for notifier in opened:
        notifier.close()


def test_a_message_is_one_datagram_of_lines(manager: Manager, close: Any) -> None:
    close(manager.notifier()).send(READY="1", STATUS="live, armed")
    assert manager.received() == ["READY=1\nSTATUS=live, armed"]


def test_ready_is_sent_once_and_only_after_the_first_complete_tick(manager: Manager, close: Any) -> None:
    notifier = close(manager.notifier())
    assert manager.received() == []
    for now in range(5):
        notifier.alive(float(now))
    assert manager.received() == ["READY=1"]


def test_the_watchdog_is_fed_four_times_an_interval_and_by_ticks_alone(manager: Manager, close: Any) -> None:
    notifier = close(manager.notifier(WATCHDOG_USEC="2000000", WATCHDOG_PID=str(os.getpid())))
    for tick in range(200):
        notifier.alive(tick * 0.01)
    assert manager.received() == ["READY=1"] + ["WATCHDOG=1"] * 4
    assert notifier.watchdog == pytest.approx(0.5)


def test_without_a_pid_the_watchdog_is_ours(manager: Manager, close: Any) -> None:
    assert close(manager.notifier(WATCHDOG_USEC="2000000")).watchdog == pytest.approx(0.5)


@pytest.mark.parametrize(
    "environment",
    [
        {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": FAR},
        {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": ""},
        {"WATCHDOG_USEC": "0"},
        {"WATCHDOG_USEC": "-5"},
        {"WATCHDOG_USEC": "2s"},
        {"WATCHDOG_USEC": "²"},
        {},
    ],
)
def test_a_watchdog_of_another_process_or_none_at_all_is_not_fed(
    manager: Manager, close: Any, environment: dict[str, str]
) -> None:
    notifier = close(manager.notifier(**environment))
    assert notifier.watchdog == inf
    notifier.alive(0.0)
    notifier.alive(1e6)
    assert manager.received() == ["READY=1"]


def test_a_changed_status_is_sent_at_most_once_a_second(manager: Manager, close: Any) -> None:
    notifier = close(manager.notifier())
    for step in range(11):
        notifier.status("24 heard", step * 0.1)
    assert manager.received() == ["STATUS=24 heard"]
    for step in range(30):  # a servo with a loose connector
        notifier.status(f"{23 + step % 2} heard", 5.0 + step * STATUS / 10)
    assert 1 <= len(manager.received()) <= 3
    notifier.status("at rest", 20.0)
    assert manager.received() == ["STATUS=at rest"]


def test_an_absent_notify_socket_causes_no_error(tmp_path: Path, close: Any) -> None:
    for address in (str(tmp_path / "gone"), "@twind-test-nobody", "relative", "/" + "x" * 200):
        close(Notifier({"NOTIFY_SOCKET": address})).send(READY="1")


def test_without_a_service_manager_nothing_is_opened_or_sent() -> None:
    before = os.listdir("/proc/self/fd")
    notifier = Notifier({})
    notifier.send(READY="1")
    notifier.alive(0.0)
    notifier.status("x", 0.0)
    assert os.listdir("/proc/self/fd") == before


def test_a_manager_that_does_not_read_never_stops_the_loop(manager: Manager, close: Any) -> None:
    notifier = close(manager.notifier())
    for number in range(2000):
        notifier.send(STATUS=str(number))
    told = manager.received()
    assert 0 < len(told) < 2000  # the kernel's queue is bounded; the rest was dropped, not waited for


# ------------------------------------------------------------------------------------- what a loop tells


class NotifyRig:
    """A daemon under a fake clock, and all that it told its manager: the kernel keeps but a few datagrams."""

    def __init__(self, folder: Path) -> None:
        self.manager = Manager(str(folder / "notify"))
        self.rig = Rig()
        self.notifier = self.manager.notifier(WATCHDOG_USEC="400000")
        self.messages: list[str] = []
        self.listen()

    def listen(self) -> None:
        """From now on the rig's loop tells this manager."""
        vars(self.rig.loop.parts.notifier).update(vars(self.notifier))

    def seconds(self, seconds: float) -> list[str]:
        """Let time pass; return the messages of that time."""
        before = len(self.messages)
        for _ in range(round(seconds / 0.05)):
            self.rig.seconds(0.05)
            self.messages += self.manager.received()
        return self.messages[before:]

    def status(self) -> str:
        """The last, a while later."""
        self.seconds(1.5)
        return [line for line in self.messages if line.startswith("STATUS=")][-1].removeprefix("STATUS=")


@pytest.fixture
def telling(tmp_path: Path) -> Iterator[NotifyRig]:
    telling = NotifyRig(tmp_path)
    yield telling
    telling.rig.close()
    telling.notifier.close()
    telling.manager.socket.close()


def test_a_tick_that_failed_feeds_no_watchdog_and_is_not_ready(telling: NotifyRig) -> None:
    twin = telling.rig.loop.parts.twin
    healthy = twin.update
    twin.update = lambda *_: 1 / 0
    telling.rig.ticks(2)  # the third in a row would end the daemon
    assert {"READY=1", "WATCHDOG=1"}.isdisjoint(telling.manager.received())
    twin.update = healthy
    telling.rig.ticks(1)
    assert {"READY=1", "WATCHDOG=1"} <= set(telling.manager.received())
    assert telling.seconds(1.0).count("WATCHDOG=1") == 10  # four times an interval


def test_the_status_names_the_first_thing_that_is_wrong(telling: NotifyRig) -> None:
    well = "live, connected, 24 of 24 joints fresh, 100 Hz"
    telling.rig.connect()
    assert telling.status() == well
    telling.rig.call(EStop, level="cut", reason="the test")
    assert telling.status() == "live, estop, 24 of 24 joints fresh, 100 Hz; ESTOP: the test"
    telling.rig.call(Reset)
    assert telling.status() == well
    telling.rig.virtual["main"].faults.unplug()
    said = telling.status()
    assert said.startswith("live, disconnected, 0 of 24 joints fresh, 100 Hz; ")
    assert "no such port" in said


def test_the_status_reports_inherited_torque_and_a_missing_servo(telling: NotifyRig) -> None:
    rig = telling.rig
    for row in range(24):
        rig.virtual["main"].servos.torque(row, True)
    rig.connect()
    assert telling.status().endswith("100 Hz; torque was found on")
    rig.virtual["main"].faults.unplug()
    rig.virtual["main"].faults.silence(5)
    telling.seconds(0.1)
    rig.virtual["main"].faults.replug()
    telling.seconds(1.0)
    name = rig.robot.joints[4].name
    assert f"DEVICE_MISSING {name}: nothing answers as id 5" in telling.status()


def test_a_client_s_words_in_the_status_are_no_orders_to_the_manager(telling: NotifyRig) -> None:
    telling.rig.connect()
    telling.rig.call(EStop, level="cut", reason="one\nMAINPID=1")
    assert telling.status().endswith("ESTOP: one MAINPID=1")
    assert not [said for said in telling.messages if "\n" in said]


def test_a_way_down_that_takes_long_asks_the_manager_for_its_time(telling: NotifyRig) -> None:
    rig = telling.rig
    rig.arm()
    rig.submit(rig.path("head_yaw", [0.8], [3.0]), more=True)  # keeps the lease
    telling.seconds(3.5)
    slow = rig.loop.robot.limits.velocity.copy()
    slow[0] = 0.2  # rad/s
    redescribe(rig.loop, limits=replace(rig.loop.robot.limits, velocity=slow))
    rig.loop.condition.stop_wanted = True
    [asked] = [line for line in telling.seconds(1.0) if line.startswith("EXTEND_TIMEOUT_USEC=")]
    lasts = 1.875 * 0.8 / (0.95 * 0.2)
    assert int(asked.partition("=")[2]) / 1e6 == pytest.approx(lasts + LETTING_GO, abs=0.2)
