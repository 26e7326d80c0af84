"""`twindctl doctor` beside a real service: as operator, as stranger; it is running, stopped or failed."""

import json
from collections.abc import Iterator

import pytest

from tests.support.systemd.machine import Machine
from tests.support.systemd.service import Json, Robot, Service, settings
from twind.doctor import host

pytestmark = pytest.mark.slow

OF_THE_MACHINE = {row.code for row in host.ROWS}  # what this one may really lack


def ask(machine: Machine, *words: str, user: str | None = None) -> Json:
    """Output of `twindctl --json doctor`; no user here has a home folder."""
    command = ["env", "HOME=/nonexistent", "twindctl", "--json", "doctor", *words]
    done = machine.try_run(*command, user=user, seconds=60.0)
    assert done.returncode in (0, 1) and done.stdout, done.stderr
    said: Json = json.loads(done.stdout)
    return said


def codes(report: Json) -> set[str]:
    """Findings that are not informative only."""
    return {each["code"] for each in report["found"] if each["severity"] != "note"}


@pytest.fixture(scope="module")
def served(machine: Machine, robot: Robot) -> Iterator[Service]:
    """A service in live mode on it."""
    file = settings(machine, "twind", robot.settings())
    service = Service(machine).start()
    service.reach(state="connected")
    yield service
    service.stop()
    service.reset()
    file.unlink()


def test_a_service_that_is_well_gives_no_alarm_to_root(served: Service) -> None:
    said = ask(served.machine)
    assert codes(said) <= OF_THE_MACHINE | {"TICKS_MISSED"}, said["found"]  # the machine is shared
    assert {"service", "daemon", "sockets", "versions", "files as read", "rights", "state folder"} <= set(
        said["looked"]
    )


def test_the_doctor_reads_the_files_and_rights_of_the_service_as_any_user(served: Service) -> None:
    said = ask(served.machine, "--only", "FILE_REFUSED", "PORT_DENIED", "CALIBRATION_MISSING", user="pilot")
    assert (said["found"], said["not_looked"]) == ([], [])
    assert set(said["looked"]) == {"files", "model", "rights", "calibration"}


def test_a_user_outside_the_groups_receives_the_name_of_the_group(served: Service) -> None:
    said = ask(served.machine, "--only", "DAEMON_DENIED", user="stranger")
    (finding,) = said["found"]
    assert finding["code"] == "DAEMON_DENIED" and "user stranger is not in group" in finding["measured"]
    assert finding["command"] == "sudo usermod -aG twind-operator stranger"


def test_a_port_that_the_services_user_may_not_open_is_found_and_so_when_it_is_given_back(
    served: Service, robot: Robot
) -> None:
    node = served.machine.inside(robot.ports["main"])
    node.chmod(0o600)
    try:
        (finding,) = ask(served.machine, "--only", "PORT_DENIED")["found"]
    finally:
        node.chmod(0o660)
    assert "the daemon's user twind may not; it is root:dialout 0600" in finding["measured"]
    assert ask(served.machine, "--only", "PORT_DENIED")["found"] == []


def test_a_stopped_service_is_healthy_and_a_failed_one_is_reported_with_its_last_log_lines(
    served: Service, robot: Robot
) -> None:
    machine = served.machine
    served.stop()
    only = ("--only", "UNIT_FAILED", "UNIT_RESTARTED", "NO_DAEMON")
    assert codes(ask(machine, *only)) == set()
    settings(machine, "twind", robot.settings(rate_hx=3))
    try:
        assert machine.try_run("systemctl", "start", served.unit, seconds=30.0).returncode != 0
        served.until(ActiveState="failed")
        said = ask(machine, *only, "FILE_REFUSED")
    finally:
        settings(machine, "twind", robot.settings())
        served.start()
    assert [each["code"] for each in said["found"]] == ["FILE_REFUSED", "UNIT_FAILED", "NO_DAEMON"]
    refused, failed, _ = said["found"]
    assert (
        refused["thing"].startswith("/etc/twind/twind.yaml:1:") and "nearest: rate_hz" in refused["measured"]
    )
    assert "exit-code, status 2" in failed["measured"]
    assert "/etc/twind/twind.yaml:1:" in failed["remedy"]  # its own words
    assert failed["command"].splitlines()[1] == "sudo systemctl start twind.service"


def test_looking_does_not_start_a_service_that_a_connection_would_start(served: Service) -> None:
    machine = served.machine
    served.stop()
    machine.run("systemctl", "start", "twind-control.socket", "twind-observe.socket")
    try:
        (finding,) = ask(machine, "--only", "NO_DAEMON", "LATENCY_FLOOR", "NO_REALTIME")["found"]
        assert served.show("ActiveState") == "inactive"
        assert "twind.service is stopped, and a connection would start it" in finding["measured"]
        assert machine.run("twindctl", "--json", "status"), "and does, for who wants it"
        assert served.show("ActiveState") == "active"
    finally:
        machine.run("systemctl", "stop", "twind-control.socket", "twind-observe.socket", "twind.service")
        served.start()


def test_a_killed_and_restarted_service_is_reported(served: Service) -> None:
    served.machine.kill(served.main())
    served.until(NRestarts="1", ActiveState="active")
    (finding,) = ask(served.machine, "--only", "UNIT_RESTARTED")["found"]
    assert finding["measured"] == "restarted once since it was started"
