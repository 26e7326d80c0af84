"""Findings about a daemon that does not answer."""

import os
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from twind.client import NoDaemon
from twind.doctor import daemon
from twind.doctor.check_context import CheckContext
from twind.doctor.host_inspector import HostInspector
from twind.doctor.service import UserAccount


@pytest.mark.parametrize(
    ("full", "asleep", "other", "code"),
    [
        (True, "", False, "DAEMON_SILENT"),
        (False, "twind.service", False, "NO_DAEMON"),
        (False, "", True, "NO_DAEMON"),
        (False, "", False, "NO_DAEMON"),
    ],
)
def test_reason_without_daemon_follows_from_fields(
    tmp_path: Path, full: bool, asleep: str, other: bool, code: str
) -> None:
    (tmp_path / "control.sock").touch()
    world = CheckContext(host=HostInspector(), unit="twind.service")
    world.sockets = str(tmp_path)
    world.no_daemon = NoDaemon("x", full=full)
    world.asleep = asleep
    world.other_ports = other
    (found,) = daemon.check_access(world)
    assert found.code == code
    assert (asleep in found.measured) and (not other or "other ports" in found.measured)


def sockets_of(folder: Path, monkeypatch: pytest.MonkeyPatch, groups: Mapping[str, int]) -> list[str]:
    """Codes for a daemon that this user started by hand."""
    for name in ("control", "observe"):
        (folder / f"{name}.sock").touch(0o660)
    monkeypatch.setattr(daemon.service, "group_id", groups.get)
    owner = UserAccount(0, frozenset())
    monkeypatch.setattr(daemon.service, "account_of_service", lambda user, groups: owner)
    answered: Any = SimpleNamespace(need_daemon=lambda: SimpleNamespace(path=str(folder / "control.sock")))
    return [found.code for found in daemon.check_sockets(answered)]


def test_a_daemon_that_root_started_by_hand_needs_no_groups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its sockets are root's alone; another user's doctor says so (DAEMON_DENIED)."""
    assert sockets_of(tmp_path, monkeypatch, {}) == []


def test_on_a_machine_with_the_groups_a_socket_of_another_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    groups = {"twind-operator": os.getgid() + 1, "twind-observe": os.getgid()}
    assert sockets_of(tmp_path, monkeypatch, groups) == ["SOCKET_GROUP"]
