"""Subject: the service in systemd, and the user account that the daemon runs as. Reads only."""

import grp
import os
import pwd
import stat
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from twind.doctor import host_inspector
from twind.doctor.check import Check, CheckNotApplicable, DoctorFinding, Severity
from twind.doctor.check_context import CheckContext, Inspection
from twind.exceptions import OperationFailed

PROPERTIES = (
    *("LoadState", "ActiveState", "SubState", "Result", "NRestarts", "MainPID", "User"),
    *("SupplementaryGroups", "ExecMainStatus", "LimitRTPRIO", "LimitMEMLOCK"),
)
YOUNGER = 2.0  # s that a front process may be younger than its loop

ROWS = (
    Check(
        "UNIT_FAILED",
        "the service failed or was given up",
        "no daemon runs; after 5 starts in 30 s the manager stops trying",
        "correct the cause in its last lines; `sudo systemctl reset-failed twind`, then `start`",
        Severity.FAULT,
        caution="servos may have torque: support the robot before you start the daemon and disarm",
        explains=("NO_DAEMON",),
    ),
    Check(
        "UNIT_RESTARTED",
        "the service or its front process was restarted",
        "it crashed or hung: only servo watchdogs stopped the robot, or leases ended",
        "`journalctl -u twind` shows the cause",
        Severity.WARNING,
    ),
)


def check_unit(context: CheckContext) -> Iterator[DoctorFinding]:
    """UNIT_FAILED, UNIT_RESTARTED: the service as its manager reports it, with its last lines."""
    yield from judge_unit(
        context.unit, unit_properties(context), lambda: host_inspector.last_lines(context.host, context.unit)
    )


def judge_unit(name: str, seen: Mapping[str, str], last_lines: Callable[[], str]) -> Iterator[DoctorFinding]:
    """Judge the properties of a service; `last_lines` are read only if it failed."""
    result = seen.get("Result", "")
    again = f"sudo systemctl reset-failed {name}\nsudo systemctl start {name}"
    if seen.get("ActiveState") == "failed":
        reason = "start limit reached, given up" if result == "start-limit-hit" else result
        text = f"failed ({reason}, status {seen.get('ExecMainStatus')})"
        yield DoctorFinding("UNIT_FAILED", name, text, "active", again, advice=_quote(last_lines()))
    elif seen.get("ActiveState") == "activating" and seen.get("SubState") == "auto-restart":
        text = f"starts again and again ({result})"
        more = f"journalctl -u {name} -n 50"
        yield DoctorFinding("UNIT_FAILED", name, text, "active", more, advice=_quote(last_lines()))
    elif int(seen.get("NRestarts") or 0) > 0:
        times = "once" if seen["NRestarts"] == "1" else f"{seen['NRestarts']} times"
        text = f"restarted {times} since it was started"
        yield DoctorFinding("UNIT_RESTARTED", name, text, "never", f"journalctl -u {name}")


def check_front(context: CheckContext) -> Iterator[DoctorFinding]:
    """UNIT_RESTARTED: a front process that is younger than its loop is not the first one."""
    pid = daemon_pid(context)
    figures = context.need_daemon().status["loop"]
    loop = (figures["ticks"] + figures["missed"]) / figures["rate_hz"]  # the front starts with the first tick
    fronts = context.host.children(pid, "twind.front")
    if not fronts:
        raise OperationFailed(f"the children of process {pid} are hidden")
    youngest = min(age for _, age in fronts)
    if loop - youngest > YOUNGER:
        text = f"runs for {youngest:.0f} s, the loop for {loop:.0f} s: it was restarted"
        yield DoctorFinding(
            "UNIT_RESTARTED", f"front, pid {fronts[0][0]}", text, command=f"journalctl -u {context.unit}"
        )


def unit_properties(context: CheckContext) -> Mapping[str, str]:
    """Return properties of the unit, read once.

    Raises CheckNotApplicable: no systemd, or no such unit; OperationFailed.
    """
    key = f"unit {context.unit}"
    if key not in context.surveys:
        if not host_inspector.BOOTED.is_dir():
            raise CheckNotApplicable("systemd is not the init system here")
        context.surveys[key] = host_inspector.properties(context.host, context.unit, *PROPERTIES)
    found: Mapping[str, str] = context.surveys[key]
    if found.get("LoadState") in (None, "not-found"):
        raise CheckNotApplicable(f"there is no {context.unit}")
    return found


def daemon_pid(context: CheckContext) -> int:
    """Return the pid of the daemon: the listener on its socket, or the main process of the service.

    Raises OperationFailed.
    """
    pid = context.need_daemon().listener
    if pid > 1:
        return pid
    try:
        return int(unit_properties(context)["MainPID"])
    except CheckNotApplicable as error:
        raise OperationFailed(f"which process the daemon is: {error}") from error


def own_pids(context: CheckContext) -> set[int]:
    """Return the pid of the daemon that was asked, as a set; empty without one."""
    return set() if context.daemon is None else {daemon_pid(context)}


def _quote(last_lines: str) -> str:
    quoted = "".join(f"\n    | {line}" for line in last_lines.splitlines())
    return f"mend what its last lines say:{quoted}\nthen:"


# ------------------------------------------------------------------------------------------- accounts


@dataclass(frozen=True)
class UserAccount:
    """User with the groups that its process has."""

    uid: int
    gids: frozenset[int]

    @property
    def name(self) -> str:
        """Name of the user; its number where it has none."""
        return user_name(self.uid)

    def may(self, path: Path, want: int) -> bool:
        """Return whether it has access `want` (os.R_OK | os.W_OK | os.X_OK), by owner, group and mode.

        Checks the path and its folders. Raises OSError: missing or hidden; OperationFailed: an access
        control list decides.
        """
        if self.uid == 0:
            path.stat()
            return True
        real = path.resolve()
        return all(self._bits(above, os.X_OK) for above in real.parents) and self._bits(real, want)

    def _bits(self, path: Path, want: int) -> bool:
        found = path.stat()
        if "system.posix_acl_access" in _attributes(path) and found.st_uid != self.uid:
            raise OperationFailed(f"{path} has an access control list: `getfacl {path}`")
        shift = 6 if found.st_uid == self.uid else 3 if found.st_gid in self.gids else 0
        return (stat.S_IMODE(found.st_mode) >> shift) & want == want


def runner_account(context: CheckContext) -> tuple[UserAccount, str]:
    """Return the account that the daemon has or would have, and its description. Raises OperationFailed."""
    if context.daemon is not None:
        return account_of_process(context.host.proc, daemon_pid(context)), "the daemon's user"
    try:
        seen = unit_properties(context)
    except CheckNotApplicable:
        return own_account(), "this user"
    account = account_of_service(seen.get("User", ""), seen.get("SupplementaryGroups", ""))
    return account, "the service's user"


def own_account() -> UserAccount:
    """Return the account of this process."""
    return UserAccount(os.geteuid(), frozenset({os.getegid(), *os.getgroups()}))


def account_of_process(proc: Path, pid: int) -> UserAccount:
    """Return the account of a process, with its present groups. Raises OperationFailed."""
    try:
        lines = (proc / str(pid) / "status").read_text().splitlines()
    except OSError as error:
        raise OperationFailed(f"process {pid}: {error.strerror}") from error
    words = {line.partition(":")[0]: line.partition(":")[2].split() for line in lines}
    return UserAccount(int(words["Uid"][1]), frozenset(map(int, (words["Gid"][1], *words.get("Groups", ())))))


def account_of_service(user: str, groups: str) -> UserAccount:
    """Return the account of a service with User= and SupplementaryGroups=.

    Raises OperationFailed: there is no such user.
    """
    try:
        entry = pwd.getpwnam(user or "root")
    except KeyError:
        raise OperationFailed(f"there is no user {user!r}") from None
    gids = set(os.getgrouplist(entry.pw_name, entry.pw_gid))
    gids |= {gid for name in groups.split() if (gid := group_id(name)) is not None}
    return UserAccount(entry.pw_uid, frozenset(gids))


def is_enrolled(uid: int, gid: int) -> bool:
    """Return whether the user database lists the user in the group, whatever groups its processes have."""
    try:
        entry = pwd.getpwuid(uid)
    except KeyError:
        return False
    return gid in os.getgrouplist(entry.pw_name, entry.pw_gid)


def group_id(name: str) -> int | None:
    """Return the number of a group; None: there is none of that name."""
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        return None


def group_name(gid: int) -> str:
    """Return the name of a group; its number where it has none."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def user_name(uid: int) -> str:
    """Return the name of a user; its number where it has none."""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def _attributes(path: Path) -> list[str]:
    try:
        return os.listxattr(path)
    except OSError:  # a file system without
        return []


CHECKS = (
    Inspection("service", ("UNIT_FAILED", "UNIT_RESTARTED"), check_unit),
    Inspection("front", ("UNIT_RESTARTED",), check_front),
)
