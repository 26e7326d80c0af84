"""Findings about a daemon that does not answer."""

from pathlib import Path

import pytest

from twind.client import NoDaemon
from twind.doctor import daemon
from twind.doctor.check_context import CheckContext
from twind.doctor.host_inspector import HostInspector


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
