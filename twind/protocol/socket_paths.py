"""Paths of the sockets: one rule for the daemon that makes them and the clients that open them."""

import os
from collections.abc import Mapping

SYSTEM = "/run/twind"  # of the service, and of root


def own_folder(environ: Mapping[str, str], uid: int) -> str:
    """The folder of a daemon that this user starts: of the session if there is one, else beside the state."""
    if uid == 0:
        return SYSTEM
    home = environ.get("HOME") or "/"
    state = environ.get("XDG_STATE_HOME") or os.path.join(home, ".local/state")
    return os.path.join(environ.get("XDG_RUNTIME_DIR") or state, "twind")
