"""The two listening sockets of a daemon: how they are bound, and whether their files are still in place.

The mode is set by the umask before `bind`, never by chmod after it: between the two, any user could connect.
Standard library only; the loop's process and the front bind by the same rules.
"""

import contextlib
import errno
import grp
import os
import pwd
import socket
import stat
from dataclasses import dataclass
from pathlib import Path

from twind.exceptions import OperationFailed

NAMES = ("control", "observe")
GROUPS = {"control": "twind-operator", "observe": "twind-observe"}
BACKLOG = 128  # connections that may wait to be taken: a crowd must not turn away who wants to stop


@dataclass(frozen=True, slots=True)
class Listener:
    """A listening socket, and the identity of the file that clients find it by.

    The kernel keeps the file's inode for as long as the socket is open, so its number is not given out again.
    """

    bound: socket.socket
    device: int = 0
    inode: int = 0  # 0: no file was there when it was looked up
    own: bool = True  # bound by this daemon; False: by the service manager, and by it alone

    @classmethod
    def of(cls, bound: socket.socket, *, own: bool) -> "Listener":
        """The listener of a socket that is bound, with the file that is at its path now."""
        device, inode = _identity(_path(bound))
        return cls(bound, device, inode, own)

    @classmethod
    def inherited(cls, fd: int, label: str) -> "Listener":
        """The listener of an inherited descriptor, and the `label` that its process gave with it."""
        owner, *file = label.split(":")
        device, inode = map(int, file)
        return cls(socket.socket(fileno=fd), device, inode, owner == "own")

    @property
    def label(self) -> str:
        """All but the descriptor, for the command line of a process that inherits it."""
        return f"{'own' if self.own else 'manager'}:{self.device}:{self.inode}"

    @property
    def path(self) -> Path | None:
        """The path it is bound to; None: an abstract or unbound socket, which has no file."""
        return _path(self.bound)

    @property
    def in_place(self) -> bool:
        """Clients that open its path reach this socket. A socket without a file cannot lose it."""
        path = self.path
        return path is None or (self.inode != 0 and _identity(path) == (self.device, self.inode))

    def close(self) -> None:
        """Close the socket; its file stays."""
        self.bound.close()

    def remove(self) -> None:
        """Remove the file that this daemon bound, then close the socket. A second call does nothing.

        The order matters: while the socket listens, no other daemon can bind the path.
        """
        path = self.path if self.bound.fileno() >= 0 else None
        if path is not None and self.own and self.in_place:
            with contextlib.suppress(OSError):  # a file that stays is replaced at the next start
                path.unlink()
        self.close()


def listen(directory: Path, name: str) -> socket.socket:
    """Bind `directory/name.sock`, mode 0660, for its group where there is one and we may give it.

    Which it became says `group_of`. Raises OperationFailed naming who or what is in the way.
    """
    path = directory / f"{name}.sock"
    try:
        _make(directory)
        check_folder(directory)
        _clear_stale(path)
        listener = _bind(path)
    except OSError as error:
        remedy = "choose another folder with --socket DIR"
        if isinstance(error, PermissionError) and not os.path.lexists(directory):
            remedy = f"`sudo install -d -o {_user()} {directory}` makes its folder, or {remedy}"
        elif error.errno == errno.EROFS:
            # A removed folder took its writable mount along. One made in its place stays read-only.
            remedy = (
                "where a service's folder was removed, `sudo systemd-tmpfiles --create` makes it, "
                f"then restart the service, which lowers the robot first; or {remedy}"
            )
        raise OperationFailed(f"{path}: {error.strerror or error}; {remedy}") from None
    with contextlib.suppress(KeyError, PermissionError):
        os.chown(path, -1, grp.getgrnam(GROUPS[name]).gr_gid)
    return listener


def group_of(listener: socket.socket) -> str:
    """The group that may use this socket, by name; its number where it has none, "" where nobody can say."""
    try:
        gid = os.stat(listener.getsockname()).st_gid
    except (OSError, ValueError):  # bound to no path: abstract, or handed over and removed since
        return ""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _path(bound: socket.socket) -> Path | None:
    name = bound.getsockname()
    return Path(name) if isinstance(name, str) and name and not name.startswith("\0") else None


def _identity(path: Path | None) -> tuple[int, int]:
    """Device and inode of what is at `path`, links not followed; (0, 0) where nothing can be found."""
    try:
        found = os.lstat(path) if path is not None else None
    except OSError:
        found = None
    return (0, 0) if found is None else (found.st_dev, found.st_ino)


def _make(directory: Path) -> None:
    """A folder that the groups can enter, whatever our umask; one that is there stays as it is."""
    old = os.umask(0o022)
    try:
        directory.mkdir(mode=0o755, parents=True, exist_ok=True)
    finally:
        os.umask(old)


def check_folder(directory: Path) -> None:
    """Refuse a folder in which somebody else could put a socket in the place of ours."""
    if directory.is_symlink():
        raise OperationFailed(
            f"{directory}: is a symbolic link; give the folder it points to with --socket DIR"
        )
    found = directory.stat()
    _check_owner(directory, found)
    group = found.st_mode & stat.S_IWGRP and found.st_gid not in (0, os.getegid())
    if group or found.st_mode & stat.S_IWOTH:
        mode = f"{stat.S_IMODE(found.st_mode):04o}"
        remedy = "`chmod go-w` it or choose another folder with --socket DIR"
        raise OperationFailed(f"{directory}: others may write there (mode {mode}); {remedy}")


def _check_owner(path: Path, found: os.stat_result) -> None:
    if found.st_uid in (0, os.geteuid()):
        return
    owner = f"uid {found.st_uid}"
    with contextlib.suppress(KeyError):
        owner = f"{pwd.getpwuid(found.st_uid).pw_name} ({owner})"
    remedy = "run twind as that user, `chown` it, or choose another folder with --socket DIR"
    raise OperationFailed(f"{path}: belongs to {owner}, not to us (uid {os.geteuid()}) or root; {remedy}")


def _user() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def _bind(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
    old = os.umask(0o117)
    try:
        listener.bind(str(path))
        listener.listen(BACKLOG)
    except OSError:
        listener.close()
        raise
    finally:
        os.umask(old)
    return listener


def _clear_stale(path: Path) -> None:
    """Remove a socket that nobody listens on; refuse anything else that is there."""
    if path.is_symlink() or (path.exists() and not path.is_socket()):
        raise OperationFailed(
            f"{path}: is not a socket; remove it or choose another folder with --socket DIR"
        )
    if not path.exists():
        return
    _check_owner(path, path.lstat())
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)  # a daemon that hangs lets its queue fill, and is there nevertheless
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
        except BlockingIOError:
            pass
    raise OperationFailed(
        f"{path}: another twind answers there; stop it or choose another folder with --socket DIR"
    )
