"""Subject: the machine. Real time, processors, clock, folders, disks, software.

A running daemon's own rights count before any limit.
"""

import ctypes
import os
import resource
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from twind.doctor import service
from twind.doctor.check import (
    SUPPORT,
    Check,
    CheckNotApplicable,
    DoctorFinding,
    Fix,
    Severity,
)
from twind.doctor.check_context import CheckContext, Inspection
from twind.doctor.host_inspector import BOOTED, HostInspector, is_daemon
from twind.exceptions import OperationFailed
from twind.loop.process.realtime import LIMIT, PRIORITY
from twind.version import DISTRIBUTION
from twind_drivers.ports.port_holder import command

CORES = 2
LOCKED = 1 << 30  # bytes: a daemon with its model is 0.2 to 0.5 GB
OTHER_CORES = (
    "give it other cores than the loop (`cpu:` in the settings, `taskset`); "
    "where it drives no motor and monitors no safety, a lower priority: `sudo chrt -f -p 10 {0}`"
)
THRIFTY = ("powersave", "ondemand", "conservative")
NICE = 23  # CAP_SYS_NICE (linux/capability.h)
LOCK = 14  # CAP_IPC_LOCK
ERROR = 5  # TIME_ERROR (adjtimex(2))
LEAD = 300.0  # s that a file may be ahead of the clock
KERNEL = 2  # pid of kthreadd, the parent of the kernel's own threads
SPARE = 200 << 20  # bytes: half an hour of recording, and a journal
SHARE = 0.02  # of a disk, where that is less
FILES = 1000  # inodes
PYTHON = (3, 11)
SYSTEMD = 252
LOGS = Path("/var/log")

ROWS = (
    Check(
        "STATE_UNWRITABLE",
        "the daemon cannot write its state folder",
        "calibrations, recordings and dumps are lost",
        "`sudo chown twind: /var/lib/twind`",
        Severity.FAULT,
        caution="the folder must be the daemon's alone: other programs lose their files",
    ),
    Check(
        "DISK_FULL",
        "a disk is full or almost full",
        "recordings, dumps, calibrations and logs are cut off or lost",
        "`df -h`, `sudo journalctl --vacuum-size=500M`",
        Severity.WARNING,
        caution="first copy recordings, dumps and logs of a fault",
        explains=("STATE_UNWRITABLE",),
    ),
    Check(
        "NO_REALTIME",
        "the loop has no real-time scheduling or no locked memory",
        "any busy program or swapped page delays ticks, up to the servo watchdogs",
        f"the service has both; by hand `USER - rtprio {LIMIT}` and `USER - memlock unlimited` in "
        "`/etc/security/limits.d/twind.conf`; in a container `--cap-add SYS_NICE --cap-add IPC_LOCK`",
        Severity.WARNING,
        explains=("TICKS_MISSED",),
    ),
    Check(
        "CPU_GOVERNOR",
        "the processors are too few, or save power",
        "the loop waits for a core, or for one that wakes up",
        "governor `performance`; two cores or more",
        Severity.NOTE,
        caution="a small board needs cooling, and a battery empties sooner",
    ),
    Check(
        "RT_RIVAL",
        "another program has equal or higher real-time priority",
        "while it computes, the loop waits",
        "give it other cores (`cpu:` in the settings), or `sudo chrt -f -p 10 PID`",
        Severity.WARNING,
        caution="find out what it is: a program that drives motors or monitors safety must not be slowed",
        explains=("TICKS_MISSED",),
    ),
    Check(
        "CLOCK_WRONG",
        "the clock is wrong or not synchronised",
        "logs and recordings get wrong dates; the loop is not affected",
        "`sudo timedatectl set-ntp true`, or `sudo date -s 'YYYY-MM-DD HH:MM'`",
        Severity.WARNING,
    ),
    Check(
        "SOFTWARE_OLD",
        "a program or library is too old",
        "it may fail, sometimes during motion",
        "`sudo make install`, or the newer package",
        Severity.WARNING,
        caution=SUPPORT,
    ),
)


def check_state_folder(context: CheckContext) -> Iterator[DoctorFinding]:
    """STATE_UNWRITABLE: the state folder, for the daemon's user."""
    if context.settings is None:
        raise OperationFailed("the settings cannot be read")
    folder = context.settings.state_dir
    there = _existing(folder)
    account, whose = service.runner_account(context)
    try:
        may = account.may(there, os.W_OK | os.X_OK)
    except OSError as error:
        raise OperationFailed(f"{there}: {error.strerror}") from error
    if account.uid == 0 and os.statvfs(there).f_flag & os.ST_RDONLY:
        yield DoctorFinding(
            "STATE_UNWRITABLE", str(folder), "its disk is mounted read-only", "read and write"
        )
    elif not may:
        what = "may not write there" if there == folder else f"may not make it below {there}"
        command = f"sudo mkdir -p {folder}\nsudo chown {account.name}: {folder}"
        yield DoctorFinding(
            "STATE_UNWRITABLE", str(folder), f"{whose} {account.name} {what}", command=command
        )


def check_disks(context: CheckContext) -> Iterator[DoctorFinding]:
    """DISK_FULL: the disks of state and logs."""
    folders = [LOGS] if context.settings is None else [context.settings.state_dir, LOGS]
    places = {there.stat().st_dev: there for there in map(_existing, reversed(folders))}
    for there in places.values():
        disk = os.statvfs(there)
        free = disk.f_bavail * disk.f_frsize
        size = disk.f_blocks * disk.f_frsize
        least = min(SPARE, int(size * SHARE))
        if size and free < max(least, 1):
            text = f"{free >> 20} MiB free of {size >> 20}"
            yield DoctorFinding("DISK_FULL", str(there), text, f"{least >> 20} MiB or more", f"df -h {there}")
        elif disk.f_files and disk.f_favail < min(FILES, disk.f_files // 50):
            text = f"room for {disk.f_favail} more files"
            yield DoctorFinding("DISK_FULL", str(there), text, f"{FILES}", f"df -i {there}")


def check_realtime(context: CheckContext) -> Iterator[DoctorFinding]:
    """NO_REALTIME: the rights of the daemon; without one those that it would have."""
    if context.daemon is not None:
        loop = context.daemon.status["loop"]
        got = loop.get("realtime")
        denied = loop.get("realtime_denied")
        if got is None or denied is None:
            raise OperationFailed("the daemon does not report its real-time rights: its version differs")
        for key, wanted in (("scheduler", "fifo"), ("memory", "locked")):
            if key in denied:
                yield DoctorFinding("NO_REALTIME", "the running daemon", f"{key}: {got[key]}", wanted)
        return
    priority, locked, whose = _allowed(context)
    if priority is not None and priority < PRIORITY:
        text = f"{whose} allows priority {priority}"
        yield DoctorFinding("NO_REALTIME", "a daemon started now", text, f"{LIMIT}, as the service has")
    if locked is not None and locked < LOCKED:
        text = f"{whose} allows {locked >> 10} KiB to be locked"
        yield DoctorFinding("NO_REALTIME", "a daemon started now", text, "unlimited")


def check_processors(context: CheckContext) -> Iterator[DoctorFinding]:
    """CPU_GOVERNOR: too few cores, or a governor that saves power."""
    cores = len(os.sched_getaffinity(0))
    if cores < CORES:
        advice = "use two cores or more, also in a virtual machine or container"
        yield DoctorFinding(
            "CPU_GOVERNOR", "processors", f"{cores} may be used", f"{CORES} or more", advice=advice
        )
    cpus = context.host.sys / "devices/system/cpu"
    files = sorted(cpus.glob("cpu[0-9]*/cpufreq/scaling_governor"))
    thrifty = [file for file in files if context.host.text(file) in THRIFTY]
    # intel_pstate's powersave is no slow clock but the default that follows the load.
    if thrifty and not (cpus / "intel_pstate").exists():
        text = f"{context.host.text(thrifty[0])} on {len(thrifty)} of {len(files)} processors"
        glob = "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
        fix = Fix("set them to performance until the next boot", lambda: _set_performance(thrifty))
        yield DoctorFinding(
            "CPU_GOVERNOR", "processors", text, "performance", f"echo performance | sudo tee {glob}", fix
        )


def check_rivals(context: CheckContext) -> Iterator[DoctorFinding]:
    """RT_RIVAL: other programs with FIFO or RR at the loop's priority or above.

    The kernel's own threads are left out, and daemons of other robots: at the same priority neither
    interrupts the other, and ticks are short.
    """
    ours = service.own_pids(context)
    for pid in context.host.processes():
        words = context.host.stat(pid)
        if words is None or pid in ours or KERNEL in (pid, int(words[1])) or is_daemon(command(pid)):
            continue
        # fields 40 and 41 (proc(5))
        priority = int(words[37])
        policy = int(words[38])
        if policy in (os.SCHED_FIFO, os.SCHED_RR) and priority >= PRIORITY:
            kind = "FIFO" if policy == os.SCHED_FIFO else "RR"
            yield DoctorFinding(
                "RT_RIVAL",
                f"pid {pid} ({command(pid)})",
                f"{kind} priority {priority}",
                f"below {PRIORITY}",
                advice=OTHER_CORES.format(pid),
            )


def check_clock(context: CheckContext) -> Iterator[DoctorFinding]:
    """CLOCK_WRONG: files from the future; as a note: the kernel's clock is not synchronised."""
    now = datetime.now(UTC).timestamp()
    newest, name = max([_stamp(path) for path in _dated(context)], default=(0.0, ""))
    if newest > now + LEAD:
        text = f"{name} was written {(newest - now) / 3600:.1f} h from now"
        yield DoctorFinding("CLOCK_WRONG", "the clock", text, "no file of the future")
    if not is_synchronised():
        yield DoctorFinding(
            "CLOCK_WRONG",
            "the clock",
            "the kernel reports that it is not synchronised",
            command="sudo timedatectl set-ntp true",
            severity=Severity.NOTE,
        )


def check_software(context: CheckContext) -> Iterator[DoctorFinding]:
    """SOFTWARE_OLD: Python, the libraries that twind requires, systemd where it is the init system."""
    if sys.version_info < PYTHON:
        has = ".".join(map(str, sys.version_info[:3]))
        yield DoctorFinding("SOFTWARE_OLD", "Python", has, ".".join(map(str, PYTHON)))
    yield from outdated(metadata.requires(DISTRIBUTION) or [])
    if BOOTED.is_dir():
        version = int(context.host.program("systemctl", "--version").split()[1])
        if version < SYSTEMD:
            yield DoctorFinding("SOFTWARE_OLD", "systemd", str(version), f"{SYSTEMD} or newer")


def outdated(requirements: list[str]) -> Iterator[DoctorFinding]:
    """Yield SOFTWARE_OLD for each requirement `name>=1.2` that is missing or older. Extras are left out."""
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


def is_synchronised() -> bool:
    """Return whether the kernel's clock is synchronised (adjtimex(2)). Raises OperationFailed."""
    answer = ctypes.create_string_buffer(512)  # struct timex is 208 bytes; modes 0 only asks
    state = ctypes.CDLL(None, use_errno=True).adjtimex(answer)
    if state < 0:
        raise OperationFailed(f"adjtimex: {os.strerror(ctypes.get_errno())}")
    return bool(state != ERROR)


def _allowed(context: CheckContext) -> tuple[int | None, int | None, str]:
    """Return priority and locked bytes that a daemon may have (None: any), and the origin of the limits."""
    try:
        seen = service.unit_properties(context)
    except CheckNotApplicable:
        caps = _capabilities(context.host)
        nice = resource.getrlimit(resource.RLIMIT_RTPRIO)[1]
        locked = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
        priority = None if caps >> NICE & 1 or nice < 0 else nice
        return priority, None if caps >> LOCK & 1 or locked < 0 else locked, "the limit of this user"
    return _limit(seen.get("LimitRTPRIO")), _limit(seen.get("LimitMEMLOCK")), context.unit


def _limit(text: str | None) -> int | None:
    return None if text in (None, "", "infinity") else int(str(text))


def _capabilities(host: HostInspector) -> int:
    for line in (host.text(host.proc / "self/status") or "").splitlines():
        if line.startswith("CapEff:"):
            return int(line.split()[1], 16)
    return 0


def _existing(folder: Path) -> Path:
    """Return the folder, or the nearest folder above it that exists."""
    return next(each for each in (folder, *folder.parents) if each.exists())


def _dated(context: CheckContext) -> Iterator[Path]:
    """Yield files that must not be newer than the clock: those of the robot and of the state folder."""
    if context.robot is not None:
        yield from (context.robot.path, context.robot.mjcf_path)
    if context.settings is not None:
        yield from context.settings.state_dir.glob("*")
        yield from context.settings.state_dir.glob("calibration/*")


def _stamp(path: Path) -> tuple[float, str]:
    try:
        return path.stat().st_mtime, str(path)
    except OSError:
        return 0.0, str(path)


def _set_performance(files: list[Path]) -> None:
    for file in files:
        file.write_text("performance\n")


def _numbers(version: str) -> tuple[int, ...]:
    """Parse 1.10.2rc1 as (1, 10, 2)."""
    parts = []
    for part in version.split("."):
        digits = part[: len(part) - len(part.lstrip("0123456789"))]
        if not digits:
            break
        parts.append(int(digits))
    return tuple(parts)


CHECKS = (
    Inspection("real time", ("NO_REALTIME",), check_realtime),
    Inspection("processors", ("CPU_GOVERNOR",), check_processors),
    Inspection("other real-time programs", ("RT_RIVAL",), check_rivals),
    Inspection("clock", ("CLOCK_WRONG",), check_clock),
    Inspection("state folder", ("STATE_UNWRITABLE",), check_state_folder),
    Inspection("disks", ("DISK_FULL",), check_disks),
    Inspection("software", ("SOFTWARE_OLD",), check_software),
)
