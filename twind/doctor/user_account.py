"""User account that the daemon runs as, or would run as, and its access rights. Opens no file."""

import grp
import os
import pwd
import stat
from dataclasses import dataclass
from pathlib import Path

from twind.doctor.check import CheckUnavailable


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

        Checks the path and its folders. Raises OSError: missing or hidden; CheckUnavailable: an access
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
            raise CheckUnavailable(f"{path} has an access control list: `getfacl {path}`")
        shift = 6 if found.st_uid == self.uid else 3 if found.st_gid in self.gids else 0
        return (stat.S_IMODE(found.st_mode) >> shift) & want == want


def own() -> UserAccount:
    """Return the account of this process."""
    return UserAccount(os.geteuid(), frozenset({os.getegid(), *os.getgroups()}))


def of_process(proc: Path, pid: int) -> UserAccount:
    """Return the account of a process, with its present groups. Raises CheckUnavailable."""
    try:
        lines = (proc / str(pid) / "status").read_text().splitlines()
    except OSError as error:
        raise CheckUnavailable(f"process {pid}: {error.strerror}") from error
    words = {line.partition(":")[0]: line.partition(":")[2].split() for line in lines}
    return UserAccount(int(words["Uid"][1]), frozenset(map(int, (words["Gid"][1], *words.get("Groups", ())))))


def of_service(user: str, groups: str) -> UserAccount:
    """Return the account of a service with User= and SupplementaryGroups=.

    Raises CheckUnavailable: there is no such user.
    """
    try:
        entry = pwd.getpwnam(user or "root")
    except KeyError:
        raise CheckUnavailable(f"there is no user {user!r}") from None
    gids = set(os.getgrouplist(entry.pw_name, entry.pw_gid))
    for name in groups.split():
        if (gid := group_id(name)) is not None:
            gids.add(gid)
    return UserAccount(entry.pw_uid, frozenset(gids))


def enrolled(uid: int, gid: int) -> bool:
    """Return whether the user database lists the user in the group, whatever groups its processes have."""
    try:
        entry = pwd.getpwuid(uid)
    except KeyError:
        return False
    return gid in os.getgrouplist(entry.pw_name, entry.pw_gid)


def group_id(name: str) -> int | None:
    """Number of a group; None: there is none of that name."""
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        return None


def group_name(gid: int) -> str:
    """Name of a group; its number where it has none."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def user_name(uid: int) -> str:
    """Name of a user; its number where it has none."""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def _attributes(path: Path) -> list[str]:
    try:
        return os.listxattr(path)
    except OSError:  # a file system without
        return []
