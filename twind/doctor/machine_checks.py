"""Checks of real time, memory, processors and clock. What a running daemon got counts before any limit."""

import ctypes
import os
import resource
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from twind.doctor import systemd
from twind.doctor.check import CheckNotApplicable, CheckUnavailable, DoctorFinding, Fix
from twind.doctor.check_context import CheckContext
from twind.doctor.host_inspector import HostInspector, is_daemon
from twind.loop.realtime import LIMIT, PRIORITY
from twind_drivers.dynamixel.port_holder import command

CORES = 2
LOCKED = 1 << 30  # bytes: a daemon with its model is 0.2 to 0.5 GB
OTHER_CORES = (
    "give it other cores than the loop (`cpu:` in the settings, `taskset`); "
    "where it drives no motor and watches over nothing, a lower priority: `sudo chrt -f -p 10 {0}`"
)
THRIFTY = ("powersave", "ondemand", "conservative")
# CAP_SYS_NICE, CAP_IPC_LOCK (linux/capability.h)
NICE = 23
LOCK = 14
# STA_UNSYNC, TIME_ERROR (adjtimex(2))
UNSYNCED = 0x40
ERROR = 5
LEAD = 300.0  # s that a file may be ahead of the clock
KERNEL = 2  # pid of kthreadd, the parent of the kernel's own threads


def realtime(x: CheckContext) -> Iterator[DoctorFinding]:
    """NO_REALTIME, MEMORY_UNLOCKED: what the daemon got; without one, what it would be allowed."""
    if x.daemon is not None:
        got, denied = (x.daemon.status["loop"].get(key) for key in ("realtime", "realtime_denied"))
        if got is None or denied is None:
            raise CheckUnavailable("the daemon does not report what it was denied: its version differs")
        for key, code, wanted in (
            ("scheduler", "NO_REALTIME", "fifo"),
            ("memory", "MEMORY_UNLOCKED", "locked"),
        ):
            if key in denied:
                yield DoctorFinding(code, "the running daemon", f"{key}: {got[key]}", wanted)
        return
    nice, locked, whose = _allowed(x)
    if nice is not None and nice < PRIORITY:
        said = f"{whose} allows priority {nice}"
        yield DoctorFinding("NO_REALTIME", "a daemon started now", said, f"{LIMIT}, as the service has")
    if locked is not None and locked < LOCKED:
        said = f"{whose} allows {locked >> 10} KiB to be locked"
        yield DoctorFinding("MEMORY_UNLOCKED", "a daemon started now", said, "unlimited")


def processors(x: CheckContext) -> Iterator[DoctorFinding]:
    """CPU_FEW, CPU_GOVERNOR."""
    cores = len(os.sched_getaffinity(0))
    if cores < CORES:
        yield DoctorFinding("CPU_FEW", "processors", f"{cores} may be used", f"{CORES} or more")
    files = sorted((x.host.sys / "devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"))
    thrifty = [file for file in files if x.host.text(file) in THRIFTY]
    # intel_pstate's powersave is no slow clock but the default that follows the load.
    if thrifty and not (x.host.sys / "devices/system/cpu/intel_pstate").exists():
        said = f"{x.host.text(thrifty[0])} on {len(thrifty)} of {len(files)} processors"
        glob = "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
        fix = Fix("set them to performance until the next boot", lambda: _perform(thrifty))
        yield DoctorFinding(
            "CPU_GOVERNOR", "processors", said, "performance", f"echo performance | sudo tee {glob}", fix
        )


def rivals(x: CheckContext) -> Iterator[DoctorFinding]:
    """RT_RIVAL: others with FIFO or RR at the loop's priority or above, the kernel's own threads left out."""
    ours = {systemd.daemon_pid(x)} if x.daemon is not None else set()
    for pid in x.host.processes():
        words = x.host.stat(pid)
        if words is None or pid in ours or KERNEL in (pid, int(words[1])):
            continue
        if is_daemon(
            command(pid)
        ):  # of another robot: at the same priority nobody interrupts, and ticks are short
            continue
        # fields 40 and 41 (proc(5))
        priority = int(words[37])
        policy = int(words[38])
        if policy in (os.SCHED_FIFO, os.SCHED_RR) and priority >= PRIORITY:
            what = f"pid {pid} ({command(pid)})"
            kind = "FIFO" if policy == os.SCHED_FIFO else "RR"
            yield DoctorFinding(
                "RT_RIVAL",
                what,
                f"{kind} priority {priority}",
                f"below {PRIORITY}",
                advice=OTHER_CORES.format(pid),
            )


def clock(x: CheckContext) -> Iterator[DoctorFinding]:
    """CLOCK_WRONG, CLOCK_UNSYNCED: the wall clock. The loop lives by the monotonic one."""
    now = datetime.now(UTC).timestamp()
    newest, name = max([_stamp(path) for path in _dated(x)], default=(0.0, ""))
    if newest > now + LEAD:
        ahead = (newest - now) / 3600
        yield DoctorFinding(
            "CLOCK_WRONG", "the clock", f"{name} was written {ahead:.1f} h from now", "no file of the future"
        )
    if not synchronised():
        yield DoctorFinding(
            "CLOCK_UNSYNCED",
            "the clock",
            "the kernel says it is not",
            command="sudo timedatectl set-ntp true",
        )


def synchronised() -> bool:
    """Does the kernel hold the clock for synchronised (adjtimex(2))? Raises CannotLook."""
    answer = ctypes.create_string_buffer(512)  # struct timex is 208 bytes; modes 0 only asks
    state = ctypes.CDLL(None, use_errno=True).adjtimex(answer)
    if state < 0:
        raise CheckUnavailable(f"adjtimex: {os.strerror(ctypes.get_errno())}")
    return bool(state != ERROR)


def _allowed(x: CheckContext) -> tuple[int | None, int | None, str]:
    """Priority and locked bytes that a daemon may have (None: any), and who says so."""
    try:
        seen = systemd.service(x)
    except CheckNotApplicable:
        caps = _capabilities(x.host)
        nice = resource.getrlimit(resource.RLIMIT_RTPRIO)[1]
        locked = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
        priority = None if caps >> NICE & 1 or nice < 0 else nice
        return priority, None if caps >> LOCK & 1 or locked < 0 else locked, "the limit of this user"
    return _limit(seen.get("LimitRTPRIO")), _limit(seen.get("LimitMEMLOCK")), x.unit


def _limit(text: str | None) -> int | None:
    return None if text in (None, "", "infinity") else int(str(text))


def _capabilities(host: HostInspector) -> int:
    for line in (host.text(host.proc / "self/status") or "").splitlines():
        if line.startswith("CapEff:"):
            return int(line.split()[1], 16)
    return 0


def _dated(x: CheckContext) -> Iterator[Path]:
    """Files whose dates the clock must be past: the robot's own, and what was written for it."""
    if x.robot is not None:
        yield from (x.robot.path, x.robot.mjcf_path)
    if x.settings is not None:
        yield from x.settings.state_dir.glob("*")
        yield from x.settings.state_dir.glob("calibration/*")


def _stamp(path: Path) -> tuple[float, str]:
    try:
        return path.stat().st_mtime, str(path)
    except OSError:
        return 0.0, str(path)


def _perform(files: list[Path]) -> None:
    for file in files:
        file.write_text("performance\n")
