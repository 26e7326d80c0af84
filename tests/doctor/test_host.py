"""Findings about the machine: real limits, rivals and clock, replaced processors and folders."""

import ctypes
import os
import resource
import struct
import time
from pathlib import Path

import pytest

from tests.support.doctor_rig import (
    found,
    host,
    mended,
    needs_root,
    plant,
    settings,
    unprivileged,
    way_to,
)
from twind.doctor.check import DoctorFinding
from twind.doctor.host import ROWS as HOST_ROWS
from twind.doctor.host import is_synchronised, outdated
from twind.loop.process.realtime import LIMIT, PRIORITY


def rights(word: str) -> list[DoctorFinding]:
    """Findings about one of the two real-time rights: "priority" or "locked"."""
    return [each for each in found(code="NO_REALTIME") if word in each.measured]


@needs_root
def test_limits_without_real_time_are_reported() -> None:
    """nobody has no capability, so the limits of this process decide; root's own are what they are."""
    if resource.getrlimit(resource.RLIMIT_RTPRIO)[1] >= PRIORITY:
        pytest.skip("the limits here allow real time to everybody")
    found(code="NO_REALTIME")
    with unprivileged():
        (finding,) = rights("priority")
        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[1]
        with pytest.raises(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    assert finding.measured == f"the limit of this user allows priority {limit}"
    assert finding.expected == f"{LIMIT}, as the service has"


def test_remedy_and_units_have_the_same_priority_limit() -> None:
    units = Path(__file__).parents[2] / "systemd"
    for unit in ("twind.service", "twind@.service", "twind-failsafe@.service"):
        assert f"LimitRTPRIO={LIMIT}\n" in (units / unit).read_text()
    (row,) = [row for row in HOST_ROWS if row.code == "NO_REALTIME"]
    assert f"rtprio {LIMIT}" in row.remedy and "/etc/security/limits.d/" in row.remedy and LIMIT >= PRIORITY


@needs_root
def test_limits_on_locked_memory_are_reported() -> None:
    hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
    if hard == resource.RLIM_INFINITY or hard > 1 << 30:
        pytest.skip("the limits here allow everybody to lock memory")
    found(code="NO_REALTIME")
    with unprivileged():
        (finding,) = rights("locked")
    assert finding.measured == f"the limit of this user allows {hard >> 10} KiB to be locked"


@needs_root
def test_real_time_rights_cause_no_finding() -> None:
    """As the kernel says it: this process really gets FIFO."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        pytest.skip("root may not have FIFO here")
    finally:
        os.sched_setscheduler(0, *before)
    assert rights("priority") == []


def test_a_single_usable_processor_is_reported_as_too_few() -> None:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        (finding,) = found(code="CPU_GOVERNOR")
    finally:
        os.sched_setaffinity(0, before)
    assert finding.measured == "1 may be used"
    assert found(code="CPU_GOVERNOR") == [] or len(before) < 2


def test_a_governor_that_saves_power_is_found_and_changed(tmp_path: Path) -> None:
    cpus = tmp_path / "devices/system/cpu"
    files = [plant(cpus / f"cpu{n}/cpufreq/scaling_governor", "performance\n") for n in range(4)]
    on = host(sys=tmp_path)
    assert found(code="CPU_GOVERNOR", on=on) == []
    for file in files[2:]:
        file.write_text("powersave\n")
    (finding,) = found(code="CPU_GOVERNOR", on=on)
    assert finding.measured == "powersave on 2 of 4 processors"
    (tried,) = mended(code="CPU_GOVERNOR", on=on)
    assert not tried.there and {file.read_text() for file in files} == {"performance\n"}


def test_intels_own_powersave_is_no_slow_clock(tmp_path: Path) -> None:
    cpus = tmp_path / "devices/system/cpu"
    plant(cpus / "cpu0/cpufreq/scaling_governor", "powersave\n")
    (cpus / "intel_pstate").mkdir()
    assert found(code="CPU_GOVERNOR", on=host(sys=tmp_path)) == []


def test_a_file_with_a_future_time_reports_a_wrong_clock(tmp_path: Path) -> None:
    recording = plant(tmp_path / "state/recording.mcap", "")
    settings = plant(tmp_path / "twind.yaml", f"robot: h24\nstate_dir: {tmp_path / 'state'}\n")
    assert ahead_of_clock(settings) == []
    ahead = time.time() + 7200
    os.utime(recording, (ahead, ahead))
    (finding,) = ahead_of_clock(settings)
    assert str(recording) in finding.measured and "2.0 h from now" in finding.measured


def ahead_of_clock(settings: Path) -> list[DoctorFinding]:
    """Findings about files; the state of the kernel's clock is that of this machine."""
    return [each for each in found("--config", str(settings), code="CLOCK_WRONG") if each.severity is None]


def test_clock_state_equals_that_of_the_kernel() -> None:
    """By the status word of adjtimex, where the check goes by its return value (adjtimex(2))."""
    buffer = ctypes.create_string_buffer(512)
    assert ctypes.CDLL(None).adjtimex(buffer) >= 0
    (status,) = struct.unpack_from("i", buffer, 40)  # modes, offset, freq, maxerror, esterror: 8 bytes each
    assert is_synchronised() == (not status & 0x40)
    assert [each.thing for each in found(code="CLOCK_WRONG")] == ([] if is_synchronised() else ["the clock"])


def test_a_state_folder_that_can_be_made_gives_no_alarm(tmp_path: Path, robot: Path) -> None:
    assert found("--config", str(settings(tmp_path, robot)), code="STATE_UNWRITABLE") == []


@needs_root
def test_state_folder_of_another_user_is_reported(tmp_path: Path, robot: Path) -> None:
    for folder in (*way_to(tmp_path), robot.parent):
        os.chmod(folder, 0o755)
    (tmp_path / "state").mkdir(mode=0o755)
    file = settings(tmp_path, robot)
    found("--config", str(file), code="STATE_UNWRITABLE")
    with unprivileged():
        (finding,) = found("--config", str(file), code="STATE_UNWRITABLE")
    assert finding.thing == str(tmp_path / "state") and "nobody may not write there" in finding.measured
    assert f"sudo chown nobody: {tmp_path / 'state'}" in finding.command  # what is in it may be another's


def test_a_library_that_is_too_old_or_missing_is_found() -> None:
    findings = list(outdated(["numpy>=1.0", "numpy>=99.1,<100", "nosuchthing>=1", "rich>=1; extra == 'tui'"]))
    assert [(each.thing, each.expected) for each in findings] == [
        ("numpy", "99.1 or newer"),
        ("nosuchthing", "1 or newer"),
    ]
    assert [each.command for each in findings] == ["", ""], (
        "from an index it would be another twind's library"
    )


def test_installed_libraries_cause_no_finding() -> None:
    assert found(code="SOFTWARE_OLD") == []
