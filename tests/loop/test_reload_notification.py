"""Messages to a service manager about a reload, ended and endless; real datagrams."""

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.daemon_rig import Rig
from tests.support.reload_changes import NARROW, codes, held
from twind import link
from twind.loop.procedures import reload_coordinator
from twind.loop.process.service_notify import Notifier
from twind.robot.finding import ReasonCode


@pytest.fixture
def managed(tmp_path: Path) -> Iterator[tuple[Rig, Any]]:
    """A service manager's socket, and what it was told since the last look."""
    rig = Rig()
    rig.connect()
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(tmp_path / "notify"))
    manager.setblocking(False)
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify")})
    rig.loop.parts.notifier.close()
    object.__setattr__(rig.loop.parts, "notifier", notifier)

    def received_lines() -> list[str]:
        found = []
        while True:
            try:
                found.append(manager.recv(4096).decode())
            except BlockingIOError:
                return found

    rig.ticks(2)
    received_lines()
    yield rig, received_lines
    notifier.close()
    manager.close()
    rig.close()
    manager.close()


def test_a_hang_up_asks_the_front_and_ends_with_ready(managed: tuple[Rig, Any]) -> None:
    rig, told = managed
    rig.loop.commands.reloads.wanted = True
    rig.ticks(1)
    (first,) = [text for text in told() if "RELOADING" in text]
    stamp = int(first.removeprefix("RELOADING=1\nMONOTONIC_USEC="))
    assert abs(stamp / 1e6 - rig.clock.now()) < 0.1, "in the same datagram (sd_notify(3))"
    assert [news for news in rig.news if isinstance(news, link.ReloadWanted)]
    rig.front.outer.send(link.encode(link.ReloadStarted()))
    rig.ticks(10)
    assert not [text for text in told() if "READY" in text or "RELOADING" in text]
    rig.adopt(NARROW, needs_restart=["rate_hz"])
    rig.seconds(1.2)
    said = told()
    assert said.count("READY=1") == 1
    assert "for a restart: rate_hz" in rig.events("RELOADED")[-1].message
    assert any(text.endswith("; restart for rate_hz") for text in said)


def test_a_refused_reload_also_ends_with_ready_and_a_status_with_the_cause(managed: tuple[Rig, Any]) -> None:
    rig, told = managed
    rig.front.outer.send(link.encode(link.ReloadStarted()))
    rig.front.outer.send(link.encode(link.ReloadFailed(message="a.yaml:3:1: no such key")))
    rig.seconds(1.2)
    said = told()
    assert [text for text in said if "RELOADING" in text]
    assert "READY=1" in said
    assert any("refused: a.yaml:3:1" in text for text in said)
    assert rig.events("RELOAD_REFUSED")
    rig.adopt({})
    rig.seconds(1.2)
    assert not any("refused" in text for text in told() if text.startswith("STATUS")), "mended"


def test_files_that_arrive_after_the_reload_timeout_change_nothing(
    managed: tuple[Rig, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reload_coordinator, "PATIENCE", 0.5)
    rig, told = managed
    before = held(rig)
    rig.front.outer.send(link.encode(link.ReloadStarted()))
    rig.seconds(0.7)
    assert "nothing was changed" in rig.events("RELOAD_REFUSED")[-1].message
    reply = rig.adopt({**NARROW, "thresholds.latency_warn_ms": 20.0}, announced=False)
    assert codes(reply) == [ReasonCode.BUSY]
    assert all(one is other for one, other in zip(before[1:], held(rig)[1:], strict=True))
    assert rig.loop.commands.gate_input.thresholds.latency_warn != 0.02
    assert told().count("READY=1") == 1
    assert rig.adopt(NARROW).error is None


@pytest.mark.parametrize("how", ["silent", "dead"])
def test_a_front_that_never_answers_does_not_leave_a_reload_open(
    managed: tuple[Rig, Any], how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reload_coordinator, "PATIENCE", 0.5)
    rig, told = managed
    before = held(rig)
    rig.loop.commands.reloads.wanted = True
    rig.ticks(2)
    if how == "dead":
        rig.loop.parts.link.lost = True
        rig.ticks(2)
    else:
        rig.seconds(0.7)
    assert "READY=1" in told()
    assert rig.events("RELOAD_REFUSED")
    assert all(one is other for one, other in zip(before[1:], held(rig)[1:], strict=True))
