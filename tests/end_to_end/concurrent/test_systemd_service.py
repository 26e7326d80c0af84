"""`systemctl start twind` on a machine on which nothing is set: ready, told, guarded, and nothing moves."""

import errno
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.doc_pages_text import ROOT
from tests.support.systemd.machine import SYS_RESOURCE, Machine
from tests.support.systemd.service import DYNAMIC_USER, Json, Service, Unit, unprivileged_user

SOCKETS = {"control": "twind-operator", "observe": "twind-observe"}


@pytest.fixture(scope="module")
def plain(machine: Machine) -> Iterator[Service]:
    """The service of a machine without settings, just started."""
    service = Service(machine).start()
    yield service
    service.stop()


@pytest.fixture(scope="module")
def first(plain: Service) -> Json:
    """Status as soon as `systemctl start` has returned."""
    return plain.status()


def test_start_returns_when_the_loop_ticks_and_the_socket_answers(plain: Service, first: Json) -> None:
    begun, ready = (int(plain.show(f"{name}TimestampMonotonic")) for name in ("ExecMainStart", "ActiveEnter"))
    assert ready - begun > 100_000  # us: not when the process was there, but when it said READY
    assert plain.show("SubState") == "running"
    assert first["loop"]["ticks"] > 0


def test_without_settings_it_mirrors_and_moves_nothing(first: Json) -> None:
    assert (first["mode"], first["state"], first["armed"]) == ("mirror", "disconnected", False)
    assert [bus["port"] for bus in first["buses"]] == [""]


def test_the_status_line_gives_mode_state_joints_and_rate(plain: Service) -> None:
    assert re.match(r"mirror, disconnected, 0 of 24 joints fresh, \d+ Hz", plain.show("StatusText"))


def test_the_service_runs_with_mujoco_and_without_privileges(plain: Service) -> None:
    main = plain.main()
    front = plain.front()
    assert front is not None
    for pid in (main, front):
        assert unprivileged_user(pid) != 0
    assert "libmujoco" in Path(f"/proc/{main}/maps").read_text()


def test_the_service_sees_a_read_only_machine_except_for_its_own_folders(plain: Service) -> None:
    seen = Path(f"/proc/{plain.main()}/root")  # we are root: what refuses us is no file mode
    for refused in ("etc/x", "usr/x", "opt/twind/x", "var/x", "sys/kernel/x", "proc/sys/kernel/hostname"):
        with pytest.raises(OSError) as told:
            (seen / refused).write_text("")
        assert told.value.errno in (errno.EROFS, errno.EACCES), refused
    for own in ("run/twind/x", "var/lib/twind/x"):
        (seen / own).write_text("")
        (seen / own).unlink()
    assert not list((seen / "root").iterdir())
    assert not list((seen / "home").iterdir())


def test_the_service_may_open_pseudo_terminals_and_no_other_device(plain: Service) -> None:
    machine = plain.machine
    node = machine.inside("/dev/ttyOTHER")
    if not node.exists():
        machine.run("mknod", "-m", "666", "/dev/ttyOTHER", "c", "4", "63")
    tried = "import os, sys\nfor each in sys.argv[1:]:\n try: os.open(each, os.O_RDWR | os.O_NOCTTY)\n"
    tried += " except OSError as error: print(error.errno)\n else: print(0)"
    codes = plain.within("/opt/twind/bin/python", "-c", tried, "/dev/ptmx", "/dev/ttyOTHER", "/dev/null")
    assert codes.split() == ["0", str(errno.EPERM), "0"]
    opened = "import sys\nfrom twind_drivers.ports.serial_port import PortError, SerialTransport\n"
    opened += "try: SerialTransport(sys.argv[1], 57600)\nexcept PortError as error: print(error)"
    told = plain.within("/opt/twind/bin/python", "-c", opened, "/dev/ttyOTHER")
    assert "DeviceAllow=/dev/ttyOTHER" in told, "a remedy that does not help"


def test_fifo_and_locked_memory_are_had_or_missing_in_words(plain: Service, first: Json) -> None:
    got = first["loop"]["realtime"]
    if plain.machine.may(SYS_RESOURCE):  # PID 1 may raise limits
        assert (got["scheduler"], got["memory"]) == ("fifo 40", "locked")
    else:
        assert got["scheduler"].startswith("no: ") and "LimitRTPRIO" in got["scheduler"]
        assert got["memory"].startswith("no: ") and "LimitMEMLOCK" in got["memory"]
        plain.says(5.0, "FIFO", lambda line: "LimitRTPRIO" in line["MESSAGE"] and line["PRIORITY"] == "4")
        plain.says(5.0, "locks", lambda line: "LimitMEMLOCK" in line["MESSAGE"] and line["PRIORITY"] == "4")


def exposure(machine: Machine, unit: str) -> float:
    """Exposure level that systemd computes for the loaded unit."""
    said = machine.run("systemd-analyze", "security", "--no-pager", unit)
    told = re.search(r"Overall exposure level for \S+: ([\d.]+)", said)
    assert told is not None, said
    return float(told[1])


def test_the_exposure_score_is_within_the_documented_bound(machine: Machine) -> None:
    assert exposure(machine, "twind.service") <= 1.7
    assert exposure(machine, "twind@any.service") <= 1.7
    assert exposure(machine, "twind-failsafe@any.service") <= 1.7
    assert exposure(machine, "twind-sim.service") <= 1.0


def test_metrics_are_served_locally_by_a_user_without_files(plain: Service) -> None:
    machine = plain.machine
    unit = Unit(machine, "twind-metrics.service")
    scrape = "import urllib.request as u; print(u.urlopen('http://127.0.0.1:9797/metrics').read().decode())"

    def has_line(line: str) -> bool:
        done = machine.try_run("/opt/twind/bin/python", "-c", scrape)
        return line in done.stdout.splitlines()

    assert unit.show("UnitFileState") == "disabled"
    unit.start()
    try:
        machine.until(lambda: has_line('twind_mode{twind_mode="mirror"} 1.0'), 10.0, "figures")
        assert unprivileged_user(unit.main()) >= DYNAMIC_USER
    finally:
        unit.stop()
    assert exposure(machine, "twind-metrics.service") <= 1.0


def test_readings_are_streamed_by_a_user_without_files(plain: Service) -> None:
    machine = plain.machine
    unit = Unit(machine, "twind-stream.service")
    out = machine.inside("/tmp/ingest/messages.ndjson")
    assert unit.show("UnitFileState") == "disabled"
    machine.inside("/tmp/ingest.py").write_bytes((ROOT / "docs/examples/ingest/ingest.py").read_bytes())
    machine.run(
        "systemd-run", "--unit=ingest", "/opt/twind/bin/python", "/tmp/ingest.py", "--out", "/tmp/ingest"
    )
    unit.start()
    try:
        machine.until(lambda: out.exists() and out.read_text().count("\n") > 2, 20.0, "readings")
        user = unprivileged_user(unit.main())
        assert user >= DYNAMIC_USER
        spool = machine.inside("/var/lib/private/twind-stream/spool.sqlite")
        assert (spool.stat().st_uid, spool.parent.stat().st_mode & 0o777) == (user, 0o700)
        assert plain.status()["streams"][0]["endpoint"] == "http://localhost:8000/ingest"
    finally:
        unit.stop()
        machine.run("systemctl", "stop", "ingest.service")
    assert unit.show("Result") == "success"
    assert exposure(machine, "twind-stream.service") <= 1.0


def test_the_journal_has_levels_and_fields(plain: Service) -> None:
    line = plain.says(5.0, "START", lambda line: line.get("TWIND_CODE") == "START")
    assert line["PRIORITY"] == "6" and "mode mirror" in line["MESSAGE"]
    assert (line["_SYSTEMD_UNIT"], line["SYSLOG_IDENTIFIER"]) == ("twind.service", "twind")
    by_code = plain.machine.run("journalctl", "--no-pager", "-o", "cat", "-u", plain.unit, "TWIND_CODE=START")
    told = by_code.splitlines()
    assert line["MESSAGE"] in told and all(each.startswith("START: ") for each in told)


def test_each_socket_is_for_its_group_alone(plain: Service) -> None:
    machine = plain.machine
    for name, group in SOCKETS.items():
        place = f"/run/twind/{name}.sock"
        assert machine.run("stat", "-c", "%a %U %G", place).split() == ["660", "twind", group]
    assert machine.run("stat", "-c", "%a %U %G", "/run/twind").split() == ["755", "twind", "twind"]


def test_an_observer_may_look_and_stop_but_not_command(plain: Service) -> None:
    machine = plain.machine
    assert "mirror" in machine.run("twindctl", "status", user="watcher")
    refused = machine.try_run("twindctl", "mode", "sim", user="watcher")
    assert refused.returncode != 0 and "permission" in refused.stderr.lower(), refused
    assert plain.status()["mode"] == "mirror"
    machine.run("twindctl", "estop", user="watcher")
    assert [fault["code"] for fault in plain.status()["faults"]], "the e-stop latched nothing"
    machine.until(lambda: "estop" in plain.show("StatusText"), 5.0, "the status line")
    machine.run("twindctl", "reset", user="pilot")
    assert plain.status()["faults"] == []


def test_a_user_without_a_group_receives_the_names_of_the_groups(plain: Service) -> None:
    refused = plain.machine.try_run("twindctl", "status", user="stranger")
    assert refused.returncode == 3
    assert "twind-operator" in refused.stderr and "twind-observe" in refused.stderr


def test_a_front_that_is_killed_is_replaced_while_the_service_stays(plain: Service) -> None:
    main = plain.main()
    front = plain.front()
    assert front is not None
    plain.machine.kill(front)
    plain.machine.until(lambda: plain.front() not in (None, front), 10.0, "another front")
    plain.reach(mode="mirror")
    assert plain.main() == main
    assert (plain.show("NRestarts"), plain.show("ActiveState")) == ("0", "active")
    plain.says(5.0, "why", lambda line: "signal 9" in line["MESSAGE"] and line["PRIORITY"] == "4")


def test_stopped_it_leaves_its_state_and_the_sockets_folder(plain: Service) -> None:
    machine = plain.machine
    kept = machine.inside("/var/lib/twind/kept")
    kept.write_text("")
    plain.stop()
    assert (plain.show("ActiveState"), plain.show("Result")) == ("inactive", "success")
    assert kept.exists() and machine.inside("/run/twind").is_dir()
    assert machine.run("stat", "-c", "%a %U %G", "/run/twind").split() == ["755", "twind", "twind"]
