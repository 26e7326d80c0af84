"""The doctor finds what the machine lacks: real limits, real rivals, a real clock, planted processors."""

import ctypes
import os
import resource
import struct
import time
from pathlib import Path

import pytest

from tests.support.doctor_rig import ROOT, found, host, mended, nobody, options, plant, way_to
from twind.client import Client, NoDaemon
from twind.doctor import systemd, user_account
from twind.doctor.check import CheckUnavailable
from twind.doctor.context_builder import examine
from twind.doctor.host_inspector import is_daemon
from twind.doctor.machine_checks import synchronised
from twind.doctor.machine_rows import MACHINE
from twind.doctor.service_checks import judge_unit
from twind.loop.realtime import LIMIT, PRIORITY
from twind_drivers.clock import MonotonicClock

needs_root = pytest.mark.skipif(not ROOT, reason="looks as another user: needs root")


# ------------------------------------------------------------------------------------------- real time


@needs_root
def test_a_user_whose_limits_forbid_real_time_is_told() -> None:
    """nobody has no capability, so the limits of this process decide; root's own are what they are."""
    if resource.getrlimit(resource.RLIMIT_RTPRIO)[1] >= PRIORITY:
        pytest.skip("the limits here allow real time to everybody")
    found(code="NO_REALTIME")
    with nobody():
        (finding,) = found(code="NO_REALTIME")
        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[1]
        with pytest.raises(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    assert finding.measured == f"the limit of this user allows priority {limit}"
    assert finding.expected == f"{LIMIT}, as the service has"


def test_one_number_is_told_everywhere_and_the_units_have_it() -> None:
    units = Path(__file__).parents[2] / "systemd"
    for unit in ("twind.service", "twind@.service", "twind-failsafe@.service"):
        assert f"LimitRTPRIO={LIMIT}\n" in (units / unit).read_text()
    (row,) = [row for row in MACHINE if row.code == "NO_REALTIME"]
    assert f"rtprio {LIMIT}" in row.remedy and "/etc/security/limits.d/" in row.remedy and LIMIT >= PRIORITY


@needs_root
def test_a_user_who_may_lock_little_memory_is_told() -> None:
    hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
    if hard == resource.RLIM_INFINITY or hard > 1 << 30:
        pytest.skip("the limits here allow everybody to lock memory")
    found(code="MEMORY_UNLOCKED")
    with nobody():
        (finding,) = found(code="MEMORY_UNLOCKED")
    assert finding.measured == f"the limit of this user allows {hard >> 10} KiB to be locked"


@needs_root
def test_who_may_have_real_time_gets_no_alarm() -> None:
    """As the kernel says it: this process really gets FIFO."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        pytest.skip("root may not have FIFO here")
    finally:
        os.sched_setscheduler(0, *before)
    assert found(code="NO_REALTIME") == []


# ------------------------------------------------------------------------------------------- processors


def test_one_processor_is_too_few() -> None:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        (finding,) = found(code="CPU_FEW")
    finally:
        os.sched_setaffinity(0, before)
    assert finding.measured == "1 may be used"
    assert found(code="CPU_FEW") == [] or len(before) < 2


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


# ------------------------------------------------------------------------------------------- the clock


def test_a_file_from_the_future_says_that_the_clock_is_wrong(tmp_path: Path) -> None:
    recording = plant(tmp_path / "state/recording.mcap", "")
    settings = plant(tmp_path / "twind.yaml", f"robot: h24\nstate_dir: {tmp_path / 'state'}\n")
    assert found("--config", str(settings), code="CLOCK_WRONG") == []
    ahead = time.time() + 7200
    os.utime(recording, (ahead, ahead))
    (finding,) = found("--config", str(settings), code="CLOCK_WRONG")
    assert str(recording) in finding.measured and "2.0 h from now" in finding.measured


def test_whether_the_clock_is_synchronised_is_what_the_kernel_says() -> None:
    """By the status word of adjtimex, where the check goes by its return value (adjtimex(2))."""
    buffer = ctypes.create_string_buffer(512)
    assert ctypes.CDLL(None).adjtimex(buffer) >= 0
    (status,) = struct.unpack_from("i", buffer, 40)  # modes, offset, freq, maxerror, esterror: 8 bytes each
    assert synchronised() == (not status & 0x40)
    assert [each.thing for each in found(code="CLOCK_UNSYNCED")] == ([] if synchronised() else ["the clock"])


# ------------------------------------------------------------------------------------------- accounts


@needs_root
def test_what_an_account_may_is_what_the_kernel_lets_it(tmp_path: Path) -> None:
    for folder in way_to(tmp_path):
        os.chmod(folder, 0o755)
    for mode in (0o600, 0o660, 0o640, 0o666, 0o606, 0o066):
        for owner, group in ((0, 0), (65534, 0), (0, 20), (0, 65534), (65534, 65534)):
            path = plant(tmp_path / "file", "")
            os.chown(path, owner, group)
            path.chmod(mode)
            with nobody(20):
                kernel = os.access(path, os.R_OK | os.W_OK, effective_ids=True)
                ours = user_account.own()
            assert ours.may(path, os.R_OK | os.W_OK) == kernel, (oct(mode), owner, group)


@needs_root
def test_a_folder_that_may_not_be_entered_hides_what_is_in_it(tmp_path: Path) -> None:
    for folder in way_to(tmp_path):
        os.chmod(folder, 0o755)
    path = plant(tmp_path / "closed/file", "")
    path.chmod(0o666)
    path.parent.chmod(0o700)
    assert not user_account.UserAccount(65534, frozenset({65534})).may(path, os.R_OK)
    path.parent.chmod(0o711)
    assert user_account.UserAccount(65534, frozenset({65534})).may(path, os.R_OK)


def test_the_account_of_a_process_is_the_kernels() -> None:
    assert user_account.of_process(Path("/proc"), os.getpid()) == user_account.own()
    with pytest.raises(CheckUnavailable):
        user_account.of_process(Path("/proc"), 2**30)


def test_the_account_of_a_service_has_its_groups() -> None:
    root = user_account.of_service("", "tty")
    assert root.uid == 0 and user_account.group_id("tty") in root.gids
    with pytest.raises(CheckUnavailable, match="no user 'nosuchuser'"):
        user_account.of_service("nosuchuser", "")


# ------------------------------------------------------------------------------------------- the service


def unit(**changed: str) -> list[tuple[str, str, str, str]]:
    """Findings of a unit of which `systemctl show` said the usual, with changes."""
    said = {"ActiveState": "active", "SubState": "running", "Result": "success", "NRestarts": "0"} | changed
    text = "".join(f"{key}={value}\n" for key, value in said.items())
    findings = judge_unit("twind.service", systemd.parse(text), lambda: "its last words")
    return [(each.code, each.measured, each.command, each.advice) for each in findings]


def test_a_service_that_runs_or_is_stopped_gives_no_alarm() -> None:
    assert unit() == unit(ActiveState="inactive", SubState="dead") == unit(NRestarts="") == []


def test_a_service_that_was_given_up_is_told_with_its_last_words_and_how_to_start_it() -> None:
    ((code, said, command, advice),) = unit(
        ActiveState="failed", Result="start-limit-hit", ExecMainStatus="2"
    )
    assert code == "UNIT_FAILED" and "start limit reached, given up, status 2" in said
    assert "    | its last words\n" in advice
    assert command.splitlines() == [
        "sudo systemctl reset-failed twind.service",
        "sudo systemctl start twind.service",
    ]


def test_a_service_in_a_crash_loop_or_restarted_once_is_told() -> None:
    assert unit(ActiveState="activating", SubState="auto-restart", Result="watchdog")[0][0] == "UNIT_FAILED"
    ((code, said, _, _),) = unit(NRestarts="3")
    assert code == "UNIT_RESTARTED" and said.startswith("restarted 3 times")


def test_where_systemd_is_not_init_nothing_is_said_of_a_service() -> None:
    if systemd.BOOTED.is_dir():
        pytest.skip("systemd is the init system here")
    from tests.support.doctor_rig import look

    outcome = look(only=["UNIT_FAILED"])
    assert (outcome.found, outcome.unseen, outcome.looked) == ([], [], [])


@pytest.mark.parametrize(
    ("command", "daemon"),
    [
        ("/opt/twind/versions/1/bin/python /opt/twind/bin/twind --config /etc/twind/a.yaml", True),
        ("/usr/local/bin/twind --mode live", True),
        ("python3 -m twind.cli --socket /tmp/x", True),
        ("/opt/twind/bin/python /opt/twind/bin/twind-virtual --robot h24", False),
        ("/opt/twind/bin/python -m twind.front", False),
        ("vi twinding.txt", False),
        ("", False),
    ],
)
def test_a_daemon_is_known_by_its_command_line(command: str, daemon: bool) -> None:
    assert is_daemon(command) == daemon


def absent(client: Client) -> None:
    raise NoDaemon(f"{client.path}: no daemon", absent=True)


STATES = """#!/bin/sh
[ "$*" = "show -P ActiveState {service} {socket}" ] && printf '%s\\n\\n%s\\n' {states}
"""


@pytest.mark.parametrize(
    ("path", "service", "socket"),
    [
        ("/run/twind/control.sock", "twind.service", "twind-control.socket"),
        ("/run/twind/arm/observe.sock", "twind@arm.service", "twind-observe@arm.socket"),
    ],
)
@pytest.mark.parametrize(
    ("states", "sleeps"),
    [
        ("inactive active", True),
        ("failed active", True),
        ("deactivating active", True),
        ("inactive inactive", False),
        ("active active", False),
        ("activating active", False),
        ("''", False),
    ],
)
def test_which_service_a_connection_would_start_is_asked_of_systemd_first(
    path: str,
    service: str,
    socket: str,
    states: str,
    sleeps: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    program = plant(tmp_path / "systemctl", STATES.format(service=service, socket=socket, states=states))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(systemd, "BOOTED", tmp_path)
    assert systemd.asleep(host(), path) == (service if sleeps else "")
    assert systemd.asleep(host(), "/tmp/twind/control.sock") == ""
    monkeypatch.setattr(Client, "connect", absent)  # a daemon of this machine may serve that folder
    examined = examine(options(socket=os.path.dirname(path)), host(), MonotonicClock())
    assert examined.daemon is None
    starts = socket.startswith("twind-observe")  # which is asked first
    assert not starts or ("would start it" in str(examined.no_daemon)) == sleeps
