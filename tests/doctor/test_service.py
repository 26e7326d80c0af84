"""Findings about the service, user accounts, and the units that a connection would start."""

import os
from pathlib import Path

import pytest

from tests.support.doctor_rig import (
    host,
    look,
    needs_root,
    options,
    plant,
    unprivileged,
    way_to,
)
from twind.client import Client, NoDaemon
from twind.doctor import (
    host_inspector,
    service,
)
from twind.doctor.check_context import examine
from twind.doctor.host_inspector import is_daemon
from twind.doctor.service import judge_unit
from twind.exceptions import OperationFailed
from twind_drivers.clock import MonotonicClock

STATES = """#!/bin/sh
[ "$*" = "show -P ActiveState {service} {socket}" ] && printf '%s\\n\\n%s\\n' {states}
"""


@needs_root
def test_rights_of_an_account_equal_those_of_the_kernel(tmp_path: Path) -> None:
    for folder in way_to(tmp_path):
        os.chmod(folder, 0o755)
    for mode in (0o600, 0o660, 0o640, 0o666, 0o606, 0o066):
        for owner, group in ((0, 0), (65534, 0), (0, 20), (0, 65534), (65534, 65534)):
            path = plant(tmp_path / "file", "")
            os.chown(path, owner, group)
            path.chmod(mode)
            with unprivileged(20):
                kernel = os.access(path, os.R_OK | os.W_OK, effective_ids=True)
                ours = service.own_account()
            assert ours.may(path, os.R_OK | os.W_OK) == kernel, (oct(mode), owner, group)


@needs_root
def test_closed_folder_hides_its_files(tmp_path: Path) -> None:
    for folder in way_to(tmp_path):
        os.chmod(folder, 0o755)
    path = plant(tmp_path / "closed/file", "")
    path.chmod(0o666)
    path.parent.chmod(0o700)
    assert not service.UserAccount(65534, frozenset({65534})).may(path, os.R_OK)
    path.parent.chmod(0o711)
    assert service.UserAccount(65534, frozenset({65534})).may(path, os.R_OK)


def test_the_account_of_a_process_is_the_kernels() -> None:
    assert service.account_of_process(Path("/proc"), os.getpid()) == service.own_account()
    with pytest.raises(OperationFailed):
        service.account_of_process(Path("/proc"), 2**30)


def test_the_account_of_a_service_has_its_groups() -> None:
    root = service.account_of_service("", "tty")
    assert root.uid == 0 and service.group_id("tty") in root.gids
    with pytest.raises(OperationFailed, match="no user 'nosuchuser'"):
        service.account_of_service("nosuchuser", "")


def unit(**changed: str) -> list[tuple[str, str, str, str]]:
    """Findings of a unit of which `systemctl show` said the usual, with changes."""
    said = {"ActiveState": "active", "SubState": "running", "Result": "success", "NRestarts": "0"} | changed
    text = "".join(f"{key}={value}\n" for key, value in said.items())
    findings = judge_unit("twind.service", host_inspector.parse_properties(text), lambda: "its last words")
    return [(each.code, each.measured, each.command, each.advice) for each in findings]


def test_a_service_that_runs_or_is_stopped_gives_no_alarm() -> None:
    assert unit() == unit(ActiveState="inactive", SubState="dead") == unit(NRestarts="") == []


def test_failed_service_is_reported_with_last_lines_and_commands() -> None:
    ((code, said, command, advice),) = unit(
        ActiveState="failed", Result="start-limit-hit", ExecMainStatus="2"
    )
    assert code == "UNIT_FAILED" and "start limit reached, given up, status 2" in said
    assert "    | its last words\n" in advice
    assert command.splitlines() == [
        "sudo systemctl reset-failed twind.service",
        "sudo systemctl start twind.service",
    ]


def test_restarting_service_is_reported() -> None:
    assert unit(ActiveState="activating", SubState="auto-restart", Result="watchdog")[0][0] == "UNIT_FAILED"
    ((code, said, _, _),) = unit(NRestarts="3")
    assert code == "UNIT_RESTARTED" and said.startswith("restarted 3 times")


def test_service_check_without_systemd_is_inapplicable() -> None:
    if host_inspector.BOOTED.is_dir():
        pytest.skip("systemd is the init system here")
    outcome = look(only=["UNIT_FAILED"])
    assert (outcome.found, outcome.unseen, outcome.looked) == ([], [], [])


@pytest.mark.parametrize(
    ("command", "daemon"),
    [
        ("/opt/twind/versions/1/bin/python /opt/twind/bin/twind --config /etc/twind/a.yaml", True),
        ("/usr/local/bin/twind --mode live", True),
        ("python3 -m twind.cli --socket /tmp/x", True),
        ("/opt/twind/bin/python /opt/twind/bin/twind-virtual --robot h24", False),
        ("/opt/twind/bin/python -m twind.front", False),
        ("vi twinding.txt", False),
        ("", False),
    ],
)
def test_is_daemon_by_command_line(command: str, daemon: bool) -> None:
    assert is_daemon(command) == daemon


def absent(client: Client) -> None:
    raise NoDaemon(f"{client.path}: no daemon", absent=True)


@pytest.mark.parametrize(
    ("path", "service", "socket"),
    [
        ("/run/twind/control.sock", "twind.service", "twind-control.socket"),
        ("/run/twind/arm/observe.sock", "twind@arm.service", "twind-observe@arm.socket"),
    ],
)
@pytest.mark.parametrize(
    ("states", "sleeps"),
    [
        ("inactive active", True),
        ("failed active", True),
        ("deactivating active", True),
        ("inactive inactive", False),
        ("active active", False),
        ("activating active", False),
        ("''", False),
    ],
)
def test_service_that_a_connection_would_start_is_read_from_systemd(
    path: str,
    service: str,
    socket: str,
    states: str,
    sleeps: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    program = plant(tmp_path / "systemctl", STATES.format(service=service, socket=socket, states=states))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(host_inspector, "BOOTED", tmp_path)
    assert host_inspector.asleep(host(), path) == (service if sleeps else "")
    assert host_inspector.asleep(host(), "/tmp/twind/control.sock") == ""
    monkeypatch.setattr(Client, "connect", absent)  # a daemon of this machine may serve that folder
    examined = examine(options(socket=os.path.dirname(path)), host(), MonotonicClock())
    assert examined.daemon is None
    starts = socket.startswith("twind-observe")  # which is asked first
    assert not starts or ("would start it" in str(examined.no_daemon)) == sleeps
