"""The doctor itself: its table is whole, no check crashes it, and it says what it found in both ways."""

import ast
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.doctor_rig import look, options
from twind.command_line.verb import UsageError
from twind.ctl.ctl_main import main
from twind_calibration import doctor
from twind_calibration.doctor import check_table, host_rows, report, robot_rows, runner, table_page
from twind_calibration.doctor.check import (
    Check,
    CheckNotApplicable,
    CheckUnavailable,
    Devices,
    DoctorFinding,
    Fix,
    Severity,
)
from twind_calibration.doctor.check_context import CheckContext
from twind_calibration.doctor.check_table import CHECK_BROKEN, CheckProbe
from twind_calibration.doctor.context_builder import examine, real_port
from twind_calibration.doctor.host_inspector import HostInspector
from twind_drivers.clock import MonotonicClock

ROWS = {
    row.code: row
    for row in (
        Check("CAUSE", "the cause", "it causes", "end it", Severity.WARNING, explains=("EFFECT",)),
        Check("EFFECT", "the effect", "it hurts", "see cause", Severity.FAULT),
        Check("FAULT", "a fault", "it is broken", "mend it", Severity.FAULT),
        Check("NOTE", "a note", "nice to know", "nothing", Severity.NOTE),
        CHECK_BROKEN,
    )
}


def nothing_examined() -> CheckContext:
    return CheckContext(HostInspector(), "twind.service")


def check(what: str, *found: DoctorFinding, error: Exception | None = None) -> CheckProbe:
    def check_it(x: CheckContext) -> Iterator[DoctorFinding]:
        yield from found
        if error is not None:
            raise error

    return CheckProbe(what, tuple(each.code for each in found), check_it)


def run(*checks: CheckProbe) -> runner.DoctorReport:
    return runner.run(nothing_examined(), checks, ROWS)


# ------------------------------------------------------------------------------------------------ the table


def test_every_complaint_is_looked_for_by_a_check_and_every_check_has_its_complaints() -> None:
    rows = check_table.complaints()
    seen = {code for each in check_table.checks() for code in each.codes}
    assert seen | {CHECK_BROKEN.code} == set(rows)


def test_there_are_more_than_25_complaints_each_with_words_for_people() -> None:
    rows = check_table.complaints().values()
    assert len(rows) > 25
    for row in rows:
        assert row.code.isupper() and row.title and row.why and row.remedy, row.code
        assert "\n" not in row.title + row.why + row.remedy and not row.title.endswith("."), row.code


def test_what_a_complaint_explains_is_a_complaint_of_the_table() -> None:
    rows = check_table.complaints()
    for row in rows.values():
        assert set(row.explains) <= set(rows) - {row.code}, row.code


def test_every_complaint_stands_in_a_test_that_plants_it() -> None:
    """As a value that a test looks for, of one table as of the other; in a comment or a name it is none."""
    here = Path(__file__)
    others = {*here.parent.glob("*.py"), *here.parents[1].rglob("*doctor*.py")} - {here}
    others |= set(here.parents[1].glob("end_to_end/*/*_checks_live.py"))
    trees = [ast.parse(path.read_text()) for path in others]
    values = {each.value for tree in trees for each in ast.walk(tree) if isinstance(each, ast.Constant)}
    assert {row.code for row in (*host_rows.ROWS, *robot_rows.ROWS)} - values == set()


def test_no_code_stands_in_the_table_twice() -> None:

    codes = [row.code for row in (*host_rows.ROWS, *robot_rows.ROWS)]
    assert len(codes) == len(set(codes))


def test_the_troubleshooting_page_has_the_table_as_it_is() -> None:
    text = (Path(__file__).parents[2] / "docs/troubleshooting.md").read_text()
    assert table_page.render_page(text) == text, (
        "python -m twind_calibration.doctor.table_page docs/troubleshooting.md"
    )


def test_a_page_without_a_place_for_the_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no <!-- from the doctor"):
        table_page.render_page("# nothing")


# ------------------------------------------------------------------------------------------------ the runner


def test_a_check_that_breaks_becomes_a_finding_and_the_others_go_on() -> None:
    broken = check("moons", DoctorFinding("NOTE", "a", "b"), error=ZeroDivisionError("of Jupiter"))
    outcome = run(broken, check("suns", DoctorFinding("FAULT", "c", "d")))
    assert [each.code for each in outcome.found] == ["FAULT", "CHECK_BROKEN", "NOTE"]
    assert outcome.found[1].measured == "could not look: ZeroDivisionError: of Jupiter"
    assert outcome.looked == ["suns"]


def test_what_could_not_be_looked_at_is_said_and_what_is_not_there_is_not() -> None:
    outcome = run(
        check("moons", error=CheckUnavailable("clouds")), check("CAN", error=CheckNotApplicable("no CAN"))
    )
    assert (outcome.found, outcome.looked, outcome.unseen) == ([], [], [("moons", "clouds")])
    assert report.text(outcome, ROWS, None, verbose=True).splitlines()[-1] == (
        "nothing is known; looked at: nothing; could not look at: moons (clouds)"
    )
    assert report.text(outcome, ROWS, None).endswith("looked at 0 things; could not look at: moons (clouds)")


def test_a_finding_comes_right_after_the_one_that_explains_it_and_says_so() -> None:
    outcome = run(
        check("all", *[DoctorFinding(code, "x", "y") for code in ("NOTE", "EFFECT", "CAUSE", "FAULT")])
    )
    assert [each.code for each in outcome.found] == ["FAULT", "CAUSE", "EFFECT", "NOTE"]
    assert outcome.because == {2: "CAUSE"}
    assert "probably because of CAUSE, above" in report.text(outcome, ROWS, None)


def test_two_complaints_that_explain_each_other_are_both_told() -> None:
    rows = ROWS | {
        "FAULT": replace(ROWS["FAULT"], explains=("CAUSE",)),
        "CAUSE": replace(ROWS["CAUSE"], explains=("FAULT",)),
    }
    outcome = runner.run(
        nothing_examined(),
        [check("x", DoctorFinding("FAULT", "a", "b"), DoctorFinding("CAUSE", "c", "d"))],
        rows,
    )
    assert sorted(each.code for each in outcome.found) == ["CAUSE", "FAULT"]


def test_notes_alone_are_nothing_wrong() -> None:
    outcome = run(check("all", DoctorFinding("NOTE", "x", "y")))
    assert report.count_problems(outcome, ROWS, None) == 0
    assert report.text(outcome, ROWS, None).endswith("nothing wrong; looked at 1 thing")
    assert report.text(outcome, ROWS, None, verbose=True).endswith("nothing wrong; looked at: all")


def test_a_fix_is_done_and_then_looked_for_again() -> None:
    broken = {"lamp": True, "wheel": True}

    def look_at(x: CheckContext) -> Iterator[DoctorFinding]:
        for thing, is_so in broken.items():
            if is_so:
                yield DoctorFinding(
                    "FAULT", thing, "broken", fix=Fix(f"mend the {thing}", lambda thing=thing: mend(thing))
                )  # type: ignore[misc]

    def mend(thing: str) -> None:
        if thing == "lamp":
            broken[thing] = False

    checks = [CheckProbe("things", ("FAULT",), look_at)]
    outcome = runner.run(nothing_examined(), checks, ROWS)
    tried = runner.mend(outcome, nothing_examined, checks, ROWS)
    assert [(each.found.thing, each.there) for each in tried] == [("lamp", False), ("wheel", True)]
    assert report.count_problems(outcome, ROWS, tried) == 1
    said = report.text(outcome, ROWS, tried)
    assert "mended: mend the lamp" in said and "done, but it is still there: mend the wheel" in said


def test_of_several_servos_told_as_one_those_that_are_left_are_no_success() -> None:
    told = [
        Devices("main", [(1, "neck"), (2, "hip"), (3, "knee"), (5, "toe")]),
        Devices("main", [(7, "arm")]),
        Devices("main", [(8, "hand")]),
    ]
    left = [
        Devices("main", [(5, "toe")]),
        Devices("main", [(17, "elbow")]),
        Devices("main", [(8, "hand"), (9, "x"), (10, "y"), (11, "z")]),
    ]

    def look_at(x: CheckContext) -> Iterator[DoctorFinding]:
        for thing in told:
            yield DoctorFinding(
                "FAULT", thing, "broken", fix=Fix("mend it", lambda: told.__setitem__(slice(None), left))
            )

    checks = [CheckProbe("things", ("FAULT",), look_at)]
    tried = runner.mend(runner.run(nothing_examined(), checks, ROWS), nothing_examined, checks, ROWS)
    assert [each.there for each in tried] == [True, False, True]


@pytest.mark.parametrize("before", [True, False], ids=["there already", "new"])
@pytest.mark.parametrize(
    "error", [CheckUnavailable("held"), CheckNotApplicable("gone"), ZeroDivisionError("of Jupiter")]
)
def test_a_fix_that_nobody_could_look_at_again_is_no_success(error: Exception, before: bool) -> None:
    """Unless the same was in the way before, as a bus without a port is: then all was found beside it."""
    looks = iter([before and isinstance(error, CheckUnavailable), True])

    def look_at(x: CheckContext) -> Iterator[DoctorFinding]:
        again = done
        if not again:
            yield DoctorFinding("FAULT", "x", "y", fix=Fix("mend it", lambda: done.append(1)))
        if next(looks):
            raise error

    done: list[int] = []
    checks = [CheckProbe("things", ("FAULT",), look_at)]
    outcome = runner.run(nothing_examined(), checks, ROWS)
    (tried,) = runner.mend(outcome, nothing_examined, checks, ROWS)
    if before and isinstance(error, CheckUnavailable):
        assert (tried.error, tried.there, report.count_problems(outcome, ROWS, [tried])) == ("", False, 0)
        return
    assert tried.error.startswith("it was done, but could not be looked at again: ")
    assert report.count_problems(outcome, ROWS, [tried]) == 1


def test_a_fix_that_fails_says_why_and_still_counts() -> None:
    def fail() -> None:
        raise PermissionError(13, "Permission denied", "/sys/x")

    checks = [check("all", DoctorFinding("FAULT", "x", "y", fix=Fix("write it", fail)))]
    outcome = run(*checks)
    tried = runner.mend(outcome, nothing_examined, checks, ROWS)
    assert report.count_problems(outcome, ROWS, tried) == 1
    assert "not mended: write it: [Errno 13] Permission denied: '/sys/x'" in report.text(outcome, ROWS, tried)


# ------------------------------------------------------------------------------------------------ the verb


def test_as_json_it_is_one_object_with_everything_a_finding_has(
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
    assert "no complaint 'GREMLINS'; known: FILE_REFUSED" in capsys.readouterr().err


def test_options_that_make_no_sense_are_a_usage_error(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["--socket", str(tmp_path), "doctor", "--port", "legs=/dev/x", "--robot", "h24"]) == 2
    assert "no bus 'legs'; the buses of this robot: main" in capsys.readouterr().err
    assert main(["--socket", str(tmp_path), "doctor", "--port", ""]) == 2


def test_fix_is_refused_where_nobody_can_be_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    with open("/dev/null") as nobody_there:
        monkeypatch.setattr("sys.stdin", nobody_there)
        with pytest.raises(UsageError, match="--fix --yes"):
            doctor.run(options("--fix"))


def test_only_some_codes_are_looked_for_when_asked_so(tmp_path: Path) -> None:
    outcome = look("--port", str(tmp_path / "no"), only=["PORT_MISSING"])
    assert [each.code for each in outcome.found] == ["PORT_MISSING"] and outcome.looked == ["ports"]


def test_whom_it_is_about_is_said_first(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    main(["--socket", str(tmp_path), "doctor", "--only", "PORT_UNSET"])
    first = capsys.readouterr().out.splitlines()[0]
    assert first == "robot h24, main on no port; no daemon was asked"


def test_ports_of_the_settings_that_fit_no_bus_are_a_finding_and_no_usage_error(tmp_path: Path) -> None:
    file = tmp_path / "twind.yaml"
    for ports, said in (
        ("{legs: /dev/ttyUSB0}", "no bus 'legs'; the buses of this robot: main"),
        ("{main: can:socketcan:can0}", "needs the path of a serial port"),
    ):
        file.write_text(f"robot: h24\nports: {ports}\n")
        outcome = look("--config", str(file), only=["FILE_REFUSED"])
        (finding,) = outcome.found
        assert finding.thing == str(file) and said in finding.measured


def test_a_port_is_the_same_under_each_of_its_names(tmp_path: Path) -> None:
    (tmp_path / "main").symlink_to("/dev/null")
    assert real_port(f"{tmp_path}/main") == real_port("/dev/null")
    assert real_port(f"can:slcan:{tmp_path}/main") == "can:slcan:/dev/null" != real_port("/dev/null")
    assert real_port("can:socketcan:can0") == "can:socketcan:can0"
    assert real_port("/dev/serial/by-path/pci-0000:00:14.0-port0").endswith("/pci-0000:00:14.0-port0")
    assert real_port("") == ""


def test_an_instance_is_known_by_its_settings_or_by_its_sockets(tmp_path: Path) -> None:
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
