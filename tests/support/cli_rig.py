"""Helpers shared by the computed and the real-time tests of cli."""

from twind.config.daemon_settings import DaemonSettings, load_settings


def settings(*ports: str, file: dict[str, str] | None = None) -> DaemonSettings:
    """Settings of nowhere in particular, with ports of a file below those of the command line."""
    found = load_settings(None, {"HOME": "/nowhere"}, uid=12345)
    return found.override(ports=[f"{bus}={port}" for bus, port in (file or {}).items()]).override(ports=ports)
