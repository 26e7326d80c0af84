"""Subject: the daemon and its sockets. Does it run, may this user ask it, does it answer, is it well?"""

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from twind.client.find_socket import socket_path
from twind.ctl.instance_paths import stop
from twind.ctl.reasons import remedy
from twind.doctor import service
from twind.doctor.check import (
    MANY,
    SUPPORT,
    Check,
    CheckNotApplicable,
    DoctorFinding,
    Fix,
    Severity,
)
from twind.doctor.check_context import CheckContext, Inspection
from twind.doctor.host_inspector import would_start
from twind.doctor.inspectors import PATIENCE
from twind.exceptions import OperationFailed
from twind.listening_sockets import GROUPS, NAMES
from twind.protocol.messages import FindingMessage
from twind.version import __version__

MISSED = 0.01  # share of all ticks; a loop that a debugger stopped once stays below it
ENOUGH = 500  # ticks: before, a slow start weighs too much
SHARED = ("FOREIGN_TRAFFIC", "BUS_ERRORS")  # reports of a daemon on a bus where two servos have one id
TWINS = (
    "another master, bad wiring, or two servos with one id, which a daemon cannot tell apart: stop it, which "
    "lowers the robot (`{0}`, or Ctrl-C where it runs), and ask `twindctl doctor` again: it finds the id"
)
UNUSED = "no program listens on it"
ANSWER = f"an answer within {PATIENCE:g} s"

ROWS = (
    Check(
        "DAEMON_DENIED",
        "this user may not access the running daemon",
        "every `twindctl` fails; only the group of a socket may use it",
        "`sudo usermod -aG twind-operator $USER`, then log in again",
        Severity.FAULT,
        caution="members of that group may move the robot; a daemon that ends lowers it: support it",
        explains=("NO_DAEMON", "PORT_HELD"),
    ),
    Check(
        "DAEMON_SILENT",
        "the daemon does not answer",
        "no command arrives, not even an e-stop by this socket",
        "in danger use the emergency switch; retry, then `sudo systemctl restart twind`",
        Severity.FAULT,
        caution="support the robot: restart or power-off lowers or drops it; a hung loop keeps torque on",
        explains=("PORT_HELD",),
    ),
    Check(
        "NO_DAEMON",
        "no daemon runs",
        "the robot is neither read nor moved; the findings below come without it",
        "`twind`, or `sudo systemctl start twind`; other sockets: `--socket DIR`",
        Severity.NOTE,
    ),
    Check(
        "SOCKET_GROUP",
        "a socket has the wrong group",
        "members of twind-operator (twind-observe) cannot use it, or others can",
        "`sudo chgrp twind-operator /run/twind/control.sock`",
        Severity.WARNING,
        caution="members of that group may arm and move the robot: check them",
        explains=("DAEMON_DENIED",),
    ),
    Check(
        "SOCKET_OPEN",
        "every user of this machine may command the robot",
        "any program can arm and move it",
        "`sudo chmod 0660 /run/twind/control.sock`; folder: `sudo chmod go-w /run/twind`",
        Severity.FAULT,
        caution="a program that stops the robot may lose access: add its user to the group first",
    ),
    Check(
        "VERSION_DIFFERS",
        "the daemon runs an older version of a file or of itself",
        "it uses the old file and refuses to arm; an earlier program may lack features",
        "file: `twindctl reload`; program: disarm, `sudo systemctl restart twind`",
        Severity.WARNING,
        caution=SUPPORT,
    ),
    Check(
        "TICKS_MISSED",
        "the loop misses ticks",
        "goals arrive late; after 100 ms without a packet servos stop",
        "NO_REALTIME, less load, `cpu:` in the settings, a lower `rate_hz`",
        Severity.WARNING,
    ),
    Check(
        "DAEMON_FAULT",
        "the daemon reports a fault",
        "it refuses to arm or holds until the cause is corrected",
        "correct what the message names; then `twindctl reset`",
        Severity.FAULT,
        caution=SUPPORT,
    ),
)


def check_access(context: CheckContext) -> Iterator[DoctorFinding]:
    """DAEMON_DENIED, NO_DAEMON, DAEMON_SILENT: why no daemon answers."""
    if context.daemon is not None:
        try:
            context.daemon.status  # noqa: B018  a daemon in trouble does not answer this call
        except OperationFailed as error:
            yield DoctorFinding("DAEMON_SILENT", context.daemon.path, str(error), ANSWER)
        return
    path = Path(context.sockets or os.path.dirname(socket_path())) / "control.sock"
    start = _start_command(context)
    try:
        found = path.stat()
    except PermissionError:
        if context.host.has_listener(str(path)) is False:
            yield DoctorFinding("NO_DAEMON", str(path), UNUSED, command=start)
            return
        yield DoctorFinding(
            "DAEMON_DENIED", str(path.parent), "this user may not enter the folder of the sockets"
        )
        return
    except OSError:
        yield DoctorFinding("NO_DAEMON", str(path), "there is no such socket", command=start)
        return
    unused = DoctorFinding("NO_DAEMON", str(path), UNUSED, command=start)
    if not os.access(path, os.W_OK, effective_ids=True):
        yield unused if context.host.has_listener(str(path)) is False else _denied(path, found, start)
    elif context.asleep:
        yield DoctorFinding("NO_DAEMON", str(path), would_start(context.asleep), command=start)
    elif context.other_ports:
        text = "a daemon answers, but it has other ports; it was not asked"
        yield DoctorFinding("NO_DAEMON", str(path), text)
    elif context.no_daemon is not None and context.no_daemon.full:
        yield DoctorFinding("DAEMON_SILENT", str(path), "its queue of connections is full", ANSWER)
    else:
        yield unused


def _start_command(context: CheckContext) -> str:
    """Return the command that starts the daemon: as its service where installed, else by hand."""
    try:
        service.unit_properties(context)
    except (CheckNotApplicable, OperationFailed):
        return "twind"
    return f"sudo systemctl start {context.unit.removesuffix('.service')}"


def _denied(path: Path, found: os.stat_result, start: str) -> DoctorFinding:
    """Distinguish a missing group from a missing log-in. Never advises to join the group root."""
    if found.st_gid == 0 or not found.st_mode & stat.S_IWGRP:
        owner = service.user_name(found.st_uid)
        text = f"it is {owner}'s alone: a twind that {owner} started by hand, not as the service"
        advice = f"ask it as {owner}; or end it, then start it as its service, else as yourself:"
        return DoctorFinding("DAEMON_DENIED", str(path), text, command=start, advice=advice)
    group = service.group_name(found.st_gid)
    user = service.user_name(os.geteuid())
    if service.is_enrolled(os.geteuid(), found.st_gid):
        text = f"user {user} is in group {group}, but this session began before it was"
        advice = "log out and in again; for this shell:"
        return DoctorFinding("DAEMON_DENIED", str(path), text, command=f"newgrp {group}", advice=advice)
    text = f"user {user} is not in group {group}, which the socket belongs to"
    command = f"sudo usermod -aG {group} {user}"
    return DoctorFinding("DAEMON_DENIED", str(path), text, command=command, advice="this, then log in again:")


def check_sockets(context: CheckContext) -> Iterator[DoctorFinding]:
    """SOCKET_GROUP, SOCKET_OPEN: the users that may use each socket of the daemon, or replace it."""
    folder = Path(context.need_daemon().path).parent
    seen = folder.stat()
    if seen.st_mode & stat.S_IWOTH and not seen.st_mode & stat.S_ISVTX:
        yield _open_to_all(folder, seen, 0o755, f"sudo chmod go-w {folder}")
    for name in NAMES:
        path = folder / f"{name}.sock"
        try:
            found = path.stat()
        except FileNotFoundError:
            continue
        if found.st_mode & stat.S_IWOTH:
            yield _open_to_all(path, found, 0o660, f"sudo chmod 0660 {path}")
        yield from _group(path, found, GROUPS[name])


def _open_to_all(path: Path, found: os.stat_result, mode: int, command: str) -> DoctorFinding:
    fix = Fix(f"mode {mode:04o}", lambda: path.chmod(mode))
    may = os.geteuid() in (0, found.st_uid)
    text = f"mode {stat.S_IMODE(found.st_mode):04o}"
    return DoctorFinding("SOCKET_OPEN", str(path), text, f"{mode:04o}", command, fix if may else None)


def _group(path: Path, found: os.stat_result, wanted: str) -> Iterator[DoctorFinding]:
    """SOCKET_GROUP of a daemon that could have given its socket to the group: root, or a member."""
    gid = service.group_id(wanted)
    if gid is None or gid == found.st_gid:
        return  # without the service's groups it is its owner's alone
    owner = service.account_of_service(service.user_name(found.st_uid), "")
    if owner.uid != 0 and gid not in owner.gids:
        return  # it has no right to give it to that group
    fix = None
    if os.geteuid() in (0, found.st_uid):
        fix = Fix(f"give it to group {wanted}", lambda: os.chown(path, -1, gid))
    has = f"group {service.group_name(found.st_gid)}"
    command = f"sudo chgrp {wanted} {path}"
    yield DoctorFinding("SOCKET_GROUP", str(path), has, wanted, command, fix)


def check_version(context: CheckContext) -> Iterator[DoctorFinding]:
    """VERSION_DIFFERS: the daemon against this twindctl."""
    running = context.need_daemon().status["version"]
    if running != __version__:
        restart = f"twindctl disarm\nsudo systemctl restart {context.unit}"
        yield DoctorFinding(
            "VERSION_DIFFERS", "the daemon", f"version {running}", f"{__version__}, as twindctl", restart
        )


def check_ticks(context: CheckContext) -> Iterator[DoctorFinding]:
    """TICKS_MISSED: more than a hundredth of all ticks."""
    loop = context.need_daemon().status["loop"]
    total = loop["ticks"] + loop["missed"]
    if total < ENOUGH:
        raise OperationFailed(f"the daemon has run for {loop['ticks']} ticks only")
    share = loop["missed"] / total
    if share > MISSED:
        worst = loop.get("late_max_us") or 0.0
        text = f"{loop['missed']} of {total} ticks missed ({share:.1%}), one {worst / 1e3:.1f} ms late"
        yield DoctorFinding("TICKS_MISSED", f"loop at {loop['rate_hz']:g} Hz", text, f"at most {MISSED:.0%}")


def check_faults(context: CheckContext) -> Iterator[DoctorFinding]:
    """DAEMON_FAULT: each code once, with its joints and messages."""
    daemon = context.need_daemon()
    faults: dict[str, list[FindingMessage]] = {}
    for each in daemon.status["faults"]:
        faults.setdefault(each["code"], []).append(each)
    for code, several in faults.items():
        joints = dict.fromkeys(each["joint"] for each in several if each["joint"])
        count = f", {len(joints)} joints" if len(joints) > MANY else ""
        thing = f"{code}{count}: {', '.join(joints)}" if joints else code
        messages = list(dict.fromkeys(each["message"] for each in several))
        more = [f"and {len(messages) - MANY} more"] if len(messages) > MANY else []
        advice = TWINS.format(stop(daemon.path)) if code in SHARED else remedy(code)
        yield DoctorFinding("DAEMON_FAULT", thing, "; ".join([*messages[:MANY], *more]), advice=advice)


CHECKS = (
    Inspection("daemon", ("DAEMON_DENIED", "DAEMON_SILENT", "NO_DAEMON"), check_access),
    Inspection("sockets", ("SOCKET_GROUP", "SOCKET_OPEN"), check_sockets),
    Inspection("versions", ("VERSION_DIFFERS",), check_version),
    Inspection("ticks", ("TICKS_MISSED",), check_ticks),
)
FAULT_CHECKS = (Inspection("arming", ("DAEMON_FAULT",), check_faults),)
