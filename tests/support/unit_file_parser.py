"""Unit files as the tests read them: sections and assignments, in their order."""

from collections.abc import Iterator
from pathlib import Path

SYSTEMD = Path(__file__).parents[2] / "systemd"
SERVICES = ("twind.service", "twind@.service", "twind-failsafe@.service", "twind-sim.service")
METRICS = ("twind-metrics.service", "twind-metrics@.service")
STREAM = ("twind-stream.service", "twind-stream@.service")
ROS = ("twind-ros.service", "twind-ros@.service")
UPLINK = ("twind-uplink.service", "twind-uplink@.service")
CLIENTS = (*METRICS, *STREAM, *ROS, *UPLINK)
SOCKETS = ("twind-control.socket", "twind-observe.socket", "twind-control@.socket", "twind-observe@.socket")

Lines = list[tuple[str, str, str]]  # section, key, value


def read(path: Path) -> Lines:
    """Every assignment of a unit file or a drop-in, in its order."""
    return list(_lines(path.read_text()))


def _lines(text: str) -> Iterator[tuple[str, str, str]]:
    section = ""
    for line in text.splitlines():
        if line.startswith("["):
            section = line.strip("[]")
        elif line and not line.startswith("#"):
            key, _, value = line.partition("=")
            yield section, key, value


def unit(name: str) -> Lines:
    """One of ours, by its name."""
    return read(SYSTEMD / name)


def values(lines: Lines, key: str) -> list[str]:
    """All values of a key."""
    return [value for _, name, value in lines if name == key]


def value(lines: Lines, key: str) -> str:
    """Value of a key that must stand there once."""
    found = values(lines, key)
    assert len(found) == 1, f"{key}: {found}"
    return found[0]
