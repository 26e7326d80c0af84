"""Checks of the daemon as a service: does it run, may we talk to it, does it answer, is it well."""

import os
import stat
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from twind.client.find_socket import socket_path
from twind.ctl.instances import stop
from twind.doctor import systemd, user_account
from twind.doctor.check import CheckNotApplicable, CheckUnavailable, DoctorFinding, Fix
from twind.doctor.check_context import CheckContext
from twind.doctor.daemon_inspector import PATIENCE
from twind.listening_sockets import GROUPS, NAMES
from twind.protocol.socket_paths import SYSTEM
from twind.version import __version__

MISSED = 0.01  # of all ticks; a loop that was stopped once by a debugger stays below it
ENOUGH = 500  # ticks: before, a slow start weighs too much
YOUNGER = 2.0  # s that a front may be younger than its loop
RESTARTS = 1  # of the unit
MANY = 3  # joints with one fault that are not counted
SHARED = ("FOREIGN_TRAFFIC", "BUS_ERRORS")  # how two servos with one id look to a daemon that reads them
TWINS = (
    "another master, bad wiring, or two servos with one id, which a daemon cannot tell apart: stop it, which "
    "lowers the robot (`{0}`, or Ctrl-C where it runs), and ask `twindctl doctor` again: it finds the id"
)
NOBODY = "nobody listens on it"
ANSWER = f"an answer within {PATIENCE:g} s"


def unit(x: CheckContext) -> Iterator[DoctorFinding]:
    """UNIT_FAILED, UNIT_RESTARTED: the service as its manager sees it, with its last words."""
    yield from judge_unit(x.unit, systemd.service(x), lambda: systemd.last_words(x.host, x.unit))


def judge_unit(name: str, seen: Mapping[str, str], last_words: Callable[[], str]) -> Iterator[DoctorFinding]:
    """What `systemctl show` says of a service; its `last_words` are asked for only if it failed."""
    result = seen.get("Result", "")
    again = f"sudo systemctl reset-failed {name}\nsudo systemctl start {name}"
    if seen.get("ActiveState") == "failed":
        reason = "start limit reached, given up" if result == "start-limit-hit" else result
        said = f"failed ({reason}, status {seen.get('ExecMainStatus')})"
        yield DoctorFinding("UNIT_FAILED", name, said, "active", again, advice=_mend(last_words()))
    elif seen.get("ActiveState") == "activating" and seen.get("SubState") == "auto-restart":
        said = f"starts again and again ({result})"
        more = f"journalctl -u {name} -n 50"
        yield DoctorFinding("UNIT_FAILED", name, said, "active", more, advice=_mend(last_words()))
    elif int(seen.get("NRestarts") or 0) >= RESTARTS:
        times = "once" if seen["NRestarts"] == "1" else f"{seen['NRestarts']} times"
        said = f"restarted {times} since it was started"
        yield DoctorFinding("UNIT_RESTARTED", name, said, "never", f"journalctl -u {name}")


def reach(x: CheckContext) -> Iterator[DoctorFinding]:
    """DAEMON_DENIED, NO_DAEMON, DAEMON_SILENT: why nobody answers."""
    if x.daemon is not None:
        try:
            x.daemon.status  # noqa: B018  asked for whether it answers at all
        except CheckUnavailable as error:
            yield DoctorFinding("DAEMON_SILENT", x.daemon.path, str(error), ANSWER)
        return
    path = Path(x.sockets or os.path.dirname(socket_path())) / "control.sock"
    start = _start(x)
    try:
        found = path.stat()
    except PermissionError:
        if x.host.has_listener(str(path)) is False:
            yield DoctorFinding("NO_DAEMON", str(path), NOBODY, command=start)
            return
        yield DoctorFinding(
            "DAEMON_DENIED", str(path.parent), "this user may not enter the folder of the sockets"
        )
        return
    except OSError:
        yield DoctorFinding("NO_DAEMON", str(path), "there is no such socket", command=start)
        return
    if not os.access(path, os.W_OK, effective_ids=True):
        if x.host.has_listener(str(path)) is False:
            yield DoctorFinding("NO_DAEMON", str(path), NOBODY, command=start)
        else:
            yield _denied(path, found, start)
    elif x.asleep:
        yield DoctorFinding("NO_DAEMON", str(path), systemd.would_start(x.asleep), command=start)
    elif x.other_ports:
        yield DoctorFinding(
            "NO_DAEMON", str(path), "a daemon answers, but it has other ports; it was not asked"
        )
    elif x.no_daemon is not None and x.no_daemon.full:
        yield DoctorFinding("DAEMON_SILENT", str(path), "its queue of connections is full", ANSWER)
    else:
        yield DoctorFinding("NO_DAEMON", str(path), NOBODY, command=start)


def sockets(x: CheckContext) -> Iterator[DoctorFinding]:
    """SOCKET_GROUP, SOCKET_OPEN: who may use each socket of the daemon, and who may replace it."""
    folder = Path(x.need_daemon().path).parent
    seen = folder.stat()
    sticky = seen.st_mode & stat.S_ISVTX
    if seen.st_mode & stat.S_IWOTH and not sticky:
        mode = f"mode {stat.S_IMODE(seen.st_mode):04o}"
        yield DoctorFinding(
            "SOCKET_OPEN", str(folder), mode, "0755", f"sudo chmod go-w {folder}", _mode(folder, 0o755, seen)
        )
    for name in NAMES:
        path = folder / f"{name}.sock"
        try:
            found = path.stat()
        except FileNotFoundError:
            continue
        if found.st_mode & stat.S_IWOTH:
            mode = f"mode {stat.S_IMODE(found.st_mode):04o}"
            yield DoctorFinding(
                "SOCKET_OPEN", str(path), mode, "0660", f"sudo chmod 0660 {path}", _mode(path, 0o660, found)
            )
        yield from _group(path, found, GROUPS[name])


def versions(x: CheckContext) -> Iterator[DoctorFinding]:
    """VERSION_DIFFERS: daemon against this twindctl."""
    running = x.need_daemon().status["version"]
    if running != __version__:
        restart = f"twindctl disarm\nsudo systemctl restart {x.unit}"
        yield DoctorFinding(
            "VERSION_DIFFERS", "the daemon", f"version {running}", f"{__version__}, as twindctl", restart
        )


def front(x: CheckContext) -> Iterator[DoctorFinding]:
    """FRONT_RESTARTED: a front that is younger than its loop is not the first one."""
    pid = systemd.daemon_pid(x)
    figures = x.need_daemon().status["loop"]
    loop = (figures["ticks"] + figures["missed"]) / figures["rate_hz"]  # the front is started with the first
    fronts = x.host.children(pid, "twind.front")
    if not fronts:
        raise CheckUnavailable(f"the children of process {pid} are hidden")
    youngest = min(age for _, age in fronts)
    if loop - youngest > YOUNGER:
        said = f"runs for {youngest:.0f} s, the loop for {loop:.0f} s: it was started anew"
        yield DoctorFinding(
            "FRONT_RESTARTED", f"front, pid {fronts[0][0]}", said, command=f"journalctl -u {x.unit}"
        )


def ticks(x: CheckContext) -> Iterator[DoctorFinding]:
    """TICKS_MISSED: of all ticks, more than a hundredth was skipped."""
    loop = x.need_daemon().status["loop"]
    all_of_them = loop["ticks"] + loop["missed"]
    if all_of_them < ENOUGH:
        raise CheckUnavailable(f"the daemon has run for {loop['ticks']} ticks only")
    share = loop["missed"] / all_of_them
    if share > MISSED:
        worst = loop.get("late_max_us") or 0.0
        said = f"{loop['missed']} of {all_of_them} ticks missed ({share:.1%}), "
        said += f"one {worst / 1e3:.1f} ms late"
        yield DoctorFinding("TICKS_MISSED", f"loop at {loop['rate_hz']:g} Hz", said, f"at most {MISSED:.0%}")


def _start(x: CheckContext) -> str:
    """The command that starts the daemon: as its service where that is installed, else by hand."""
    try:
        systemd.service(x)
    except (CheckNotApplicable, CheckUnavailable):
        return "twind"
    return f"sudo systemctl start {x.unit.removesuffix('.service')}"


def _mend(last_words: str) -> str:
    quoted = "".join(f"\n    | {line}" for line in last_words.splitlines())
    return f"mend what its last lines say:{quoted}\nthen:"


def _denied(path: Path, found: os.stat_result, start: str) -> DoctorFinding:
    """Whether the group or only the log-in is missing. Nobody is told to join the group root."""
    if found.st_gid == 0 or not found.st_mode & stat.S_IWGRP:
        owner = user_account.user_name(found.st_uid)
        said = f"it is {owner}'s alone: a twind that {owner} started by hand, not as the service"
        advice = f"ask it as {owner}; or end it, then start it as its service, else as yourself:"
        return DoctorFinding("DAEMON_DENIED", str(path), said, command=start, advice=advice)
    group = user_account.group_name(found.st_gid)
    user = user_account.user_name(os.geteuid())
    said = f"user {user} is not in group {group}, which the socket belongs to"
    if user_account.enrolled(os.geteuid(), found.st_gid):
        said = f"user {user} is in group {group}, but this session began before it was"
        return DoctorFinding(
            "DAEMON_DENIED",
            str(path),
            said,
            command=f"newgrp {group}",
            advice="log out and in again; for this shell:",
        )
    return DoctorFinding(
        "DAEMON_DENIED",
        str(path),
        said,
        command=f"sudo usermod -aG {group} {user}",
        advice="this, then log in again:",
    )


def _group(path: Path, found: os.stat_result, wanted: str) -> Iterator[DoctorFinding]:
    """SOCKET_GROUP of a daemon that could have given its socket to the group: root, or a member."""
    gid = user_account.group_id(wanted)
    has = user_account.group_name(found.st_gid)
    if gid == found.st_gid:
        return
    owner = user_account.of_service(user_account.user_name(found.st_uid), "")
    if gid is None and str(path.parent) != SYSTEM:
        return  # a daemon of one user, on a machine without the service's groups
    if gid is not None and owner.uid != 0 and gid not in owner.gids:
        return  # it has no right to give it to that group
    make = f"sudo groupadd -rf {wanted}\n" if gid is None else ""
    fix = (
        None
        if gid is None or os.geteuid() not in (0, found.st_uid)
        else Fix(f"give it to group {wanted}", lambda: os.chown(path, -1, gid))
    )
    yield DoctorFinding(
        "SOCKET_GROUP", str(path), f"group {has}", wanted, f"{make}sudo chgrp {wanted} {path}", fix
    )


def _mode(path: Path, mode: int, found: os.stat_result) -> Fix | None:
    if os.geteuid() not in (0, found.st_uid):
        return None
    return Fix(f"mode {mode:04o}", lambda: path.chmod(mode))


def faults(x: CheckContext) -> Iterator[DoctorFinding]:
    """DAEMON_FAULT: what the daemon itself says is wrong, each message once: why it does not arm."""
    daemon = x.need_daemon()
    told: dict[tuple[str, str], list[str]] = {}
    for each in daemon.status["faults"]:
        joints = told.setdefault((each["code"], each["message"]), [])
        joints += [each["joint"]] if each["joint"] else []
    for (code, message), joints in told.items():
        whose = f", {len(joints)} joints" if len(joints) > MANY else ""
        thing = f"{code}{whose}: {', '.join(joints)}" if joints else code
        advice = TWINS.format(stop(daemon.path)) if code in SHARED else ""
        yield DoctorFinding("DAEMON_FAULT", thing, message, advice=advice)
