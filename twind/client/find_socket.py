"""Paths of the daemon's sockets."""

import os
import stat

from twind.protocol.socket_paths import SYSTEM, own_folder

START = "start one with `twind` (or `systemctl start twind`)"


def socket_path(place: str | os.PathLike[str] | None = None, name: str = "control") -> str:
    """Path of a socket. `place` is its folder, or the socket itself.

    Without `place`: the first of this user's own folder and /run/twind that has one; /run/twind if none has.
    """
    if place is not None:
        path = os.fspath(place)
        return path if _is_socket(path) else os.path.join(path, f"{name}.sock")
    for directory in directories():
        path = os.path.join(directory, f"{name}.sock")
        if _is_socket(path):
            return path
    return os.path.join(SYSTEM, f"{name}.sock")


def how_to_start(path: str) -> str:
    """Return how to start the daemon of a socket at `path`: the instance twind@NAME in /run/twind/NAME."""
    above, name = os.path.split(os.path.dirname(path))
    start = f"start it with `systemctl start twind@{name}`" if above == SYSTEM else START
    return f"{start}, or name its folder with --socket DIR"


def directories() -> list[str]:
    """Return the folders searched, in order."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")  # also of root, who may use a session
    session = [os.path.join(runtime, "twind")] if runtime else []
    return list(dict.fromkeys([*session, own_folder(os.environ, os.getuid()), SYSTEM]))


def _is_socket(path: str) -> bool:
    try:
        return stat.S_ISSOCK(os.stat(path).st_mode)
    except OSError:
        return False
