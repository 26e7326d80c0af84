"""Description of the robot that a front receives before it serves clients: msgpack in a sealed memfd."""

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec


class JointInfo(msgspec.Struct, frozen=True):
    """Name, bus and limits of a joint."""

    name: str
    bus: str
    id: int
    calibrated: bool
    lower: float
    upper: float
    watchdog: bool = True  # False: it holds its last goal when the daemon dies
    actuator: str = ""  # what is at the end of the wire, where it is not named as the joint; empty: it is


class Briefing(msgspec.Struct, frozen=True, kw_only=True):
    """Description of the robot and the settings, by which front and loop judge alike."""

    version: str
    robot: str
    joints: Sequence[JointInfo]
    description: dict[str, Any]  # the robot file as checked
    calibration: dict[str, object] | None
    mjcf: str
    binding: bytes = b""  # the bound robot for the look-ahead (`twin/binding_transfer.py`); empty: none
    bodiless: bool = False  # the model has joints alone: neither collision nor torque is judged
    rate_hz: float
    parameters: dict[str, Any]
    log_level: str = "info"
    files: dict[str, str] = {}  # robot file, model, calibration: path -> sha256 of what was read
    texts: dict[str, str] = {}  # the same files, path -> what was read
    described: bytes = b""  # content of the files for a reload (`config/config_files.py`); empty: no reload
    generation: int = 0  # how many changes were made since the start
    replaced_gains: dict[str, dict[str, Any]] = {}  # key -> gains of the file, while a client tries others


class ReloadResult(msgspec.Struct, frozen=True, kw_only=True):
    """Changes in the files (`config/hot_changes.py`), and the briefing once `changes` are in force.

    `error`: why they cannot be used; then nothing else counts.
    """

    changes: dict[str, object] = {}
    needs_restart: Sequence[str] = ()
    briefing: Briefing | None = None
    error: str = ""


def fingerprint(version: str, files: Mapping[str, str]) -> bytes:
    """Return 16 bytes that identify a version and the files it read (path -> sha256)."""
    content = msgspec.msgpack.encode((version, sorted(files.items())))
    return hashlib.blake2b(content, digest_size=16).digest()
