"""Table and runner: the table is complete, a failing check stops no other, a fix is confirmed."""

import ast
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from twind.doctor import report, runner, write_checks_page
from twind.doctor.check import (
    Check,
    CheckNotApplicable,
    Devices,
    DoctorFinding,
    Fix,
    Severity,
)
from twind.doctor.check_context import CheckContext, Inspection
from twind.doctor.host_inspector import HostInspector
from twind.doctor.runner import CHECK_BROKEN
from twind.exceptions import OperationFailed

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


def empty_context() -> CheckContext:
    return CheckContext(HostInspector(), "twind.service")


def check(what: str, *found: DoctorFinding, error: Exception | None = None) -> Inspection:
    def check_it(x: CheckContext) -> Iterator[DoctorFinding]:
        yield from found
        if error is not None:
            raise error

    return Inspection(what, tuple(each.code for each in found), check_it)


def run(*checks: Inspection) -> runner.DoctorReport:
    return runner.run(empty_context(), checks, ROWS)


def test_checks_and_rows_have_the_same_codes() -> None:
    rows = runner.table()
    seen = {code for each in runner.all_checks() for code in each.codes}
    assert seen | {CHECK_BROKEN.code} == set(rows)


def test_table_has_at_most_60_complete_rows() -> None:
    rows = runner.table().values()
    assert 25 < len(rows) <= 60
    for row in rows:
        assert row.code.isupper() and row.title and row.why and row.remedy, row.code
        assert "\n" not in row.title + row.why + row.remedy and not row.title.endswith("."), row.code


def test_explained_codes_are_codes_of_the_table() -> None:
    rows = runner.table()
    for row in rows.values():
        assert set(row.explains) <= set(rows) - {row.code}, row.code


def test_every_code_is_planted_by_a_test() -> None:
    """As a value that a test looks for, of one table as of the other; in a comment or a name it is none."""
    here = Path(__file__)
    others = {*here.parent.glob("*.py"), *here.parents[1].rglob("*doctor*.py")} - {here}
    trees = [ast.parse(path.read_text()) for path in others]
    values = {each.value for tree in trees for each in ast.walk(tree) if isinstance(each, ast.Constant)}
    assert set(runner.table()) - {CHECK_BROKEN.code} - values == set()


def test_codes_are_unique() -> None:
    codes = [
        row.code
        for subject in (*runner.BEFORE_DEVICES, *runner.family_subjects(), runner.host)
        for row in subject.ROWS
    ]
    assert len(codes) == len(set(codes)) == len(runner.table()) - 1


def test_troubleshooting_page_has_the_present_table() -> None:
    text = (Path(__file__).parents[2] / "docs/troubleshooting.md").read_text()
    assert write_checks_page.render_page(text) == text, (
        "python -m twind.doctor.write_checks_page docs/troubleshooting.md"
    )


def test_page_without_markers_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no <!-- from the doctor"):
        write_checks_page.render_page("# nothing")


def test_failing_check_becomes_a_finding_and_others_run() -> None:
    broken = check("moons", DoctorFinding("NOTE", "a", "b"), error=ZeroDivisionError("of Jupiter"))
    outcome = run(broken, check("suns", DoctorFinding("FAULT", "c", "d")))
    assert [each.code for each in outcome.found] == ["FAULT", "CHECK_BROKEN", "NOTE"]
    assert outcome.found[1].measured == "could not look: ZeroDivisionError: of Jupiter"
    assert outcome.looked == ["suns"]


def test_unavailable_checks_are_reported_and_inapplicable_ones_are_not() -> None:
    outcome = run(
        check("moons", error=OperationFailed("clouds")), check("CAN", error=CheckNotApplicable("no CAN"))
    )
    assert (outcome.found, outcome.looked, outcome.unseen) == ([], [], [("moons", "clouds")])
    assert report.text(outcome, ROWS, None, verbose=True).splitlines()[-1] == (
        "nothing is known; looked at: nothing; could not look at: moons (clouds)"
    )
    assert report.text(outcome, ROWS, None).endswith("looked at 0 things; could not look at: moons (clouds)")


def test_finding_follows_the_finding_that_explains_it() -> None:
    outcome = run(
        check("all", *[DoctorFinding(code, "x", "y") for code in ("NOTE", "EFFECT", "CAUSE", "FAULT")])
    )
    assert [each.code for each in outcome.found] == ["FAULT", "CAUSE", "EFFECT", "NOTE"]
    assert outcome.because == {2: "CAUSE"}
    assert "probably because of CAUSE, above" in report.text(outcome, ROWS, None)


def test_findings_of_one_severity_list_buses_and_servos_before_the_machine() -> None:
    """Findings of one severity keep the order of the checks."""
    subjects = [check.what for check in runner.all_checks()]
    machine = [check.what for check in runner.host.CHECKS]
    assert subjects[-len(machine) :] == machine
    outcome = run(
        *[check(thing, DoctorFinding("FAULT", thing, "x")) for thing in ("bus", "servo", "machine")]
    )
    assert [each.thing for each in outcome.found] == ["bus", "servo", "machine"]


def test_findings_that_explain_each_other_are_both_reported() -> None:
    rows = ROWS | {
        "FAULT": replace(ROWS["FAULT"], explains=("CAUSE",)),
        "CAUSE": replace(ROWS["CAUSE"], explains=("FAULT",)),
    }
    outcome = runner.run(
        empty_context(),
        [check("x", DoctorFinding("FAULT", "a", "b"), DoctorFinding("CAUSE", "c", "d"))],
        rows,
    )
    assert sorted(each.code for each in outcome.found) == ["CAUSE", "FAULT"]


def test_notes_alone_leave_the_verdict_good() -> None:
    outcome = run(check("all", DoctorFinding("NOTE", "x", "y")))
    assert report.count_problems(outcome, ROWS, None) == 0
    assert report.text(outcome, ROWS, None).endswith("nothing wrong; looked at 1 thing")
    assert report.text(outcome, ROWS, None, verbose=True).endswith("nothing wrong; looked at: all")


def test_fix_is_followed_by_a_second_inspection() -> None:
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

    checks = [Inspection("things", ("FAULT",), look_at)]
    outcome = runner.run(empty_context(), checks, ROWS)
    tried = runner.mend(outcome, empty_context, checks, ROWS)
    assert [(each.found.thing, each.there) for each in tried] == [("lamp", False), ("wheel", True)]
    assert report.count_problems(outcome, ROWS, tried) == 1
    said = report.text(outcome, ROWS, tried)
    assert "mended: mend the lamp" in said and "done, but it is still there: mend the wheel" in said


def test_fix_is_confirmed_though_another_finding_of_the_same_code_is_left() -> None:
    """One code can stand for two settings of one thing, which differ in what they should be."""
    expected = {"short", "long"}

    def look_at(x: CheckContext) -> Iterator[DoctorFinding]:
        for each in sorted(expected):
            fix = Fix("shorten it", lambda: expected.discard("short")) if each == "short" else None
            yield DoctorFinding("FAULT", "queue", "wrong", each, fix=fix)

    checks = [Inspection("things", ("FAULT",), look_at)]
    (tried,) = runner.mend(runner.run(empty_context(), checks, ROWS), empty_context, checks, ROWS)
    assert (tried.error, tried.there) == ("", False)


def test_finding_with_its_own_severity_is_ordered_counted_and_printed_by_it() -> None:
    note = DoctorFinding("FAULT", "hubs", "x", severity=Severity.NOTE)
    outcome = run(check("all", note, DoctorFinding("CAUSE", "timer", "x")))
    assert [each.thing for each in outcome.found] == ["timer", "hubs"]
    assert report.count_problems(outcome, ROWS, None) == 1
    assert "NOTE  FAULT: a fault" in report.text(outcome, ROWS, None)
    assert [each["severity"] for each in report.data(outcome, ROWS, None)["found"]] == ["warning", "note"]


def test_joined_fix_fails_while_one_servo_is_left() -> None:
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

    checks = [Inspection("things", ("FAULT",), look_at)]
    tried = runner.mend(runner.run(empty_context(), checks, ROWS), empty_context, checks, ROWS)
    assert [each.there for each in tried] == [True, False, True]


@pytest.mark.parametrize("before", [True, False], ids=["there already", "new"])
@pytest.mark.parametrize(
    "error", [OperationFailed("held"), CheckNotApplicable("gone"), ZeroDivisionError("of Jupiter")]
)
def test_fix_without_second_inspection_is_no_success(error: Exception, before: bool) -> None:
    """Unless the same was in the way before, as a bus without a port is: then all was found beside it."""
    looks = iter([before and isinstance(error, OperationFailed), True])

    def look_at(x: CheckContext) -> Iterator[DoctorFinding]:
        again = done
        if not again:
            yield DoctorFinding("FAULT", "x", "y", fix=Fix("mend it", lambda: done.append(1)))
        if next(looks):
            raise error

    done: list[int] = []
    checks = [Inspection("things", ("FAULT",), look_at)]
    outcome = runner.run(empty_context(), checks, ROWS)
    (tried,) = runner.mend(outcome, empty_context, checks, ROWS)
    if before and isinstance(error, OperationFailed):
        assert (tried.error, tried.there, report.count_problems(outcome, ROWS, [tried])) == ("", False, 0)
        return
    assert tried.error.startswith("it was done, but could not be looked at again: ")
    assert report.count_problems(outcome, ROWS, [tried]) == 1


def test_failed_fix_reports_its_reason_and_counts() -> None:
    def fail() -> None:
        raise PermissionError(13, "Permission denied", "/sys/x")

    checks = [check("all", DoctorFinding("FAULT", "x", "y", fix=Fix("write it", fail)))]
    outcome = run(*checks)
    tried = runner.mend(outcome, empty_context, checks, ROWS)
    assert report.count_problems(outcome, ROWS, tried) == 1
    assert "not mended: write it: [Errno 13] Permission denied: '/sys/x'" in report.text(outcome, ROWS, tried)
