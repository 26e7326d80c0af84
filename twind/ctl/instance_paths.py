"""Files, sockets and units of one daemon of this machine, as systemd/README.md defines them.

The plain service reads `twind.yaml` and listens in /run/twind. `twind@NAME` reads `NAME.yaml` beside it and
listens in /run/twind/NAME.
"""

import os
from pathlib import Path

from twind.protocol.socket_paths import SYSTEM

SERVICE = "twind"


def settings_of(place: str | None, folder: Path) -> Path | None:
    """The settings of the instance whose sockets are at `place` (`-i NAME`); None: none, or it has no file.

    `folder` is that of the services' settings, /etc/twind.
    """
    name = _instance_at(place)
    file = folder / f"{name}.yaml"
    return file if name and file.exists() else None


def sockets_of(config: str | None, socket_dir: str, folder: Path) -> str:
    """Folder in which the daemon that reads `config` listens. `socket_dir`: the folder in its settings."""
    file = None if config is None else Path(os.path.abspath(config))
    told = file is not None and file.parent == folder and file.stem != SERVICE and socket_dir == SYSTEM
    return f"{socket_dir}/{file.stem}" if told and file is not None else socket_dir


def stop(place: str | None) -> str:
    """The command that stops the service at `place`, and its socket units, which would start it again."""
    name = _instance_at(place)
    at = f"@{name}" if name else ""
    return f"sudo systemctl stop {SERVICE}{at} {SERVICE}-control{at}.socket {SERVICE}-observe{at}.socket"


def restart(place: str | None) -> str:
    """The command that starts the service at `place` anew."""
    name = _instance_at(place)
    return f"sudo systemctl restart {SERVICE}{f'@{name}' if name else ''}"


def _instance_at(place: str | None) -> str:
    """`arm` for /run/twind/arm and for a socket in it; empty: no instance's."""
    folder = os.path.dirname(place or "") if (place or "").endswith(".sock") else place or ""
    return os.path.basename(folder) if os.path.dirname(folder) == SYSTEM else ""
