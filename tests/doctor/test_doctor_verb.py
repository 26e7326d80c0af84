"""Verb: options, exit codes, JSON, and the settings, ports and instance that a call means."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.doctor_rig import (
    look,
    options,
)
from twind import doctor
from twind.command_line.verb import UsageError
from twind.ctl.ctl_main import main
from twind.doctor.check_context import examine, real_port
from twind.doctor.host_inspector import HostInspector
from twind_drivers.clock import MonotonicClock


def test_json_report_is_one_object_with_all_fields_of_a_finding(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    port = tmp_path / "no-such-port"
    code = main(
        ["--socket", str(tmp_path), "--json", "doctor", "--port", str(port), "--only", "PORT_MISSING"]
    )
    said = json.loads(capsys.readouterr().out)
    assert code == 1
    assert set(said) == {"about", "found", "looked", "not_looked", "mended"}
    (finding,) = said["found"]
    assert finding["code"] == "PORT_MISSING" and finding["severity"] == "fault"
    assert finding["thing"] == str(port) and finding["fix"] is None and said["mended"] is None
    assert set(finding) == {
        "code", "severity", "title", "thing", "measured", "expected", "why", "remedy", "caution",
        "command", "fix",
        "because_of",
    }  # fmt: skip


def test_an_unknown_code_is_a_usage_error_that_lists_the_known_ones(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["doctor", "--only", "GREMLINS"]) == 2
    assert "no code 'GREMLINS'; known: FILE_REFUSED" in capsys.readouterr().err


def test_options_that_make_no_sense_are_a_usage_error(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["--socket", str(tmp_path), "doctor", "--port", "legs=/dev/x", "--robot", "h24"]) == 2
    assert "no bus 'legs'; the buses of this robot: main" in capsys.readouterr().err
    assert main(["--socket", str(tmp_path), "doctor", "--port", ""]) == 2


def test_fix_without_terminal_is_a_usage_error(monkeypatch: pytest.MonkeyPatch) -> None:
    with open("/dev/null") as nobody_there:
        monkeypatch.setattr("sys.stdin", nobody_there)
        with pytest.raises(UsageError, match="--fix --yes"):
            doctor.run(options("--fix"))


def test_only_limits_checks_and_findings(tmp_path: Path) -> None:
    outcome = look("--port", str(tmp_path / "no"), only=["PORT_MISSING"])
    assert [each.code for each in outcome.found] == ["PORT_MISSING"] and outcome.looked == ["ports"]


def test_report_begins_with_robot_and_ports(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for words, default in (([], True), (["--robot", "h24"], False)):
        main(["--socket", str(tmp_path), "doctor", *words, "--only", "PORT_UNSET"])
        first = capsys.readouterr().out.splitlines()[0]
        assert first.startswith("robot h24") and first.endswith(", main on no port; no daemon was asked")
        assert ("only the default: name yours with --robot" in first) is default


def test_wrong_ports_of_the_settings_are_a_finding(tmp_path: Path) -> None:
    file = tmp_path / "twind.yaml"
    for ports, said in (
        ("{legs: /dev/ttyUSB0}", "no bus 'legs'; the buses of this robot: main"),
        ("{main: can:socketcan:can0}", "needs the path of a serial port"),
    ):
        file.write_text(f"robot: h24\nports: {ports}\n")
        outcome = look("--config", str(file), only=["FILE_REFUSED"])
        (finding,) = outcome.found
        assert finding.thing == str(file) and said in finding.measured


def test_real_port_is_equal_for_all_names_of_a_port(tmp_path: Path) -> None:
    (tmp_path / "main").symlink_to("/dev/null")
    assert real_port(f"{tmp_path}/main") == real_port("/dev/null")
    assert real_port(f"can:slcan:{tmp_path}/main") == "can:slcan:/dev/null" != real_port("/dev/null")
    assert real_port("can:socketcan:can0") == "can:socketcan:can0"
    assert real_port("/dev/serial/by-path/pci-0000:00:14.0-port0").endswith("/pci-0000:00:14.0-port0")
    assert real_port("") == ""


def test_instance_follows_from_settings_or_sockets(tmp_path: Path) -> None:
    """twind@body.service has /etc/twind/body.yaml and /run/twind/body (design 6.3)."""
    (tmp_path / "twind").mkdir()
    file = tmp_path / "twind/body.yaml"
    file.write_text("robot: h24-split\n")
    on = replace(HostInspector(), etc=tmp_path)
    by_settings = options("--config", str(file))
    by_settings.socket = None
    for asked in (by_settings, options(socket="/run/twind/body")):
        examined = examine(asked, on, MonotonicClock())
        assert (examined.unit, examined.sockets) == ("twind@body.service", "/run/twind/body")
        assert examined.robot is not None and examined.robot.name == "h24-split"
        examined.close()
    assert examine(options(socket="/run/twind/other"), on, MonotonicClock()).unit == "twind.service"


def test_report_without_inspection_gives_no_verdict(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--socket", "/nowhere", "doctor", "--robot", "h24", "--only"]
    assert main([*words, "LATENCY_FLOOR"]) == 1
    *_, last = capsys.readouterr().out.splitlines()
    reasons = "USB (no bus has a serial port); latency (no serial port)"
    assert last == f"nothing is known; looked at 0 things; could not look at: {reasons}"
    assert main(["--json", *words, "LATENCY_FLOOR"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert said["looked"] == []
    assert {"what": "latency", "why": "no serial port"} in said["not_looked"]
    assert main(["--socket", "/nowhere", "calibrate", "scan", "--robot", "h24"]) == 1
    *_, last = capsys.readouterr().out.splitlines()
    assert last.startswith("nothing is known; looked at 0 things; could not look at: serial buses, servos (")
    assert main([*words, "FILE_REFUSED"]) == 0
    assert "nothing wrong; looked at 2 things" in capsys.readouterr().out
