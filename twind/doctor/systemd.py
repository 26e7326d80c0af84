"""The service as systemd knows it, by `systemctl show` and the journal. Only reads."""

import os
from collections.abc import Mapping
from pathlib import Path

from twind.doctor.check import CheckNotApplicable, CheckUnavailable
from twind.doctor.check_context import CheckContext
from twind.doctor.host_inspector import HostInspector
from twind.protocol.socket_paths import SYSTEM

BOOTED = Path("/run/systemd/system")  # sd_booted(3): there only where systemd is the init system
ASKED = (
    "LoadState",
    "ActiveState",
    "SubState",
    "Result",
    "NRestarts",
    "MainPID",
    "User",
    "SupplementaryGroups",
    "ExecMainStatus",
    "LimitRTPRIO",
    "LimitMEMLOCK",
)
LAST_LINES = 5
RUNNING = ("active", "activating", "reloading")


def service(x: CheckContext) -> Mapping[str, str]:
    """Properties of the unit, asked once. Raises NothingThere: no systemd, or no such unit; CannotLook."""
    key = f"unit {x.unit}"
    if key not in x.surveys:
        if not BOOTED.is_dir():
            raise CheckNotApplicable("systemd is not the init system here")
        x.surveys[key] = parse(x.host.program("systemctl", "show", x.unit, "-p", ",".join(ASKED)))
    found: Mapping[str, str] = x.surveys[key]
    if found.get("LoadState") in (None, "not-found"):
        raise CheckNotApplicable(f"there is no {x.unit}")
    return found


def parse(text: str) -> dict[str, str]:
    """`Key=value` lines of `systemctl show`."""
    return dict(line.split("=", 1) for line in text.splitlines() if "=" in line)


def asleep(host: HostInspector, path: str) -> str:
    """The service that a connection to this socket would start; "" where it would start none.

    A diagnosis starts no daemon, which would take the ports (systemd.socket(5)).
    """
    folder, file = os.path.split(os.path.abspath(path))
    above, instance = os.path.split(folder)
    if not BOOTED.is_dir() or SYSTEM not in (folder, above):
        return ""
    at = "" if folder == SYSTEM else f"@{instance}"
    service = f"twind{at}.service"
    listener = f"twind-{file.removesuffix('.sock')}{at}.socket"
    try:
        states = host.program("systemctl", "show", "-P", "ActiveState", service, listener).split()
    except CheckUnavailable:
        return ""
    return service if len(states) == 2 and states[0] not in RUNNING and states[1] == "active" else ""


def would_start(service: str) -> str:
    """A sentence on the stopped `service`."""
    return f"{service} is stopped, and a connection would start it"


def last_words(host: HostInspector, unit: str) -> str:
    """What the service said last, its final lines; why they cannot be had where they cannot."""
    try:
        said = host.program("journalctl", "-u", unit, "-n", str(LAST_LINES), "-o", "cat", "--no-pager", "-q")
    except CheckUnavailable as error:
        return f"(its journal cannot be read: {error})"
    return said.strip() or f"(no line of it may be read: `sudo journalctl -u {unit}`)"


def daemon_pid(x: CheckContext) -> int:
    """The process of the daemon that answers: who listens on its socket, or the service's main process.

    Raises CannotLook.
    """
    pid = x.need_daemon().listener
    if pid > 1:
        return pid
    try:
        return int(service(x)["MainPID"])
    except CheckNotApplicable as error:
        raise CheckUnavailable(f"which process the daemon is: {error}") from error
