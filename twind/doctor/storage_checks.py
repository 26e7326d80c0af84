"""Checks of folders, disks and installed software."""

import os
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from twind.doctor.check import CheckUnavailable, DoctorFinding
from twind.doctor.check_context import CheckContext
from twind.doctor.port_checks import runner

SPARE = 200 << 20  # bytes: half an hour of recording, and a journal
SHARE = 0.02  # of a disk, where that is less
FILES = 1000  # inodes
PYTHON = (3, 11)
SYSTEMD = 252
LOGS = Path("/var/log")


def writable(x: CheckContext) -> Iterator[DoctorFinding]:
    """STATE_UNWRITABLE: the state folder, by the daemon's user."""
    if x.settings is None:
        raise CheckUnavailable("the settings cannot be read")
    folder = x.settings.state_dir
    there = next(each for each in (folder, *folder.parents) if each.exists())
    who, whose = runner(x)
    try:
        may = who.may(there, os.W_OK | os.X_OK)
    except OSError as error:
        raise CheckUnavailable(f"{there}: {error.strerror}") from error
    if who.uid == 0 and os.statvfs(there).f_flag & os.ST_RDONLY:
        yield DoctorFinding(
            "STATE_UNWRITABLE", str(folder), "its disk is mounted read-only", "read and write"
        )
    elif not may:
        what = "may not write there" if there == folder else f"may not make it below {there}"
        command = f"sudo mkdir -p {folder}\nsudo chown {who.name}: {folder}"
        yield DoctorFinding("STATE_UNWRITABLE", str(folder), f"{whose} {who.name} {what}", command=command)


def disks(x: CheckContext) -> Iterator[DoctorFinding]:
    """DISK_FULL: the disks of state and logs."""
    seen: set[int] = set()
    folders = [LOGS] if x.settings is None else [x.settings.state_dir, LOGS]
    for folder in folders:
        there = next(each for each in (folder, *folder.parents) if each.exists())
        if (device := there.stat().st_dev) in seen:
            continue
        seen.add(device)
        disk = os.statvfs(there)
        free = disk.f_bavail * disk.f_frsize
        size = disk.f_blocks * disk.f_frsize
        least = min(SPARE, int(size * SHARE)) if size else 0
        if size and free < max(least, 1):
            said = f"{free >> 20} MiB free of {size >> 20}"
            yield DoctorFinding("DISK_FULL", str(there), said, f"{least >> 20} MiB or more", f"df -h {there}")
        elif disk.f_files and disk.f_favail < min(FILES, disk.f_files // 50):
            yield DoctorFinding(
                "DISK_FULL", str(there), f"room for {disk.f_favail} more files", f"{FILES}", f"df -i {there}"
            )


def software(x: CheckContext) -> Iterator[DoctorFinding]:
    """SOFTWARE_OLD: Python, the libraries that twind names, systemd where it is the init system."""
    if sys.version_info < PYTHON:
        had = ".".join(map(str, sys.version_info[:3]))
        yield DoctorFinding("SOFTWARE_OLD", "Python", had, ".".join(map(str, PYTHON)))
    yield from outdated(metadata.requires("twind") or [])
    if Path("/run/systemd/system").is_dir():
        version = int(x.host.program("systemctl", "--version").split()[1])
        if version < SYSTEMD:
            yield DoctorFinding("SOFTWARE_OLD", "systemd", str(version), f"{SYSTEMD} or newer")


def outdated(requirements: list[str]) -> Iterator[DoctorFinding]:
    """Yield SOFTWARE_OLD for each requirement `name>=1.2` that is missing or installed in an older version.

    Extras are left out.
    """
    for text in requirements:
        name, _, least = text.partition(";")[0].partition(">=")
        least = least.partition(",")[0].strip()
        if not least or "extra" in text:
            continue
        try:
            has = metadata.version(name.strip())
        except metadata.PackageNotFoundError:
            yield DoctorFinding("SOFTWARE_OLD", name.strip(), "not installed", f"{least} or newer")
            continue
        if _numbers(has) < _numbers(least):
            yield DoctorFinding("SOFTWARE_OLD", name.strip(), has, f"{least} or newer")


def _numbers(version: str) -> tuple[int, ...]:
    """1.10.2rc1 as (1, 10, 2)."""
    parts = []
    for part in version.split("."):
        digits = part[: len(part) - len(part.lstrip("0123456789"))]
        if not digits:
            break
        parts.append(int(digits))
    return tuple(parts)
