"""Report: commands that can be copied, cautions before remedies, text and JSON."""

import argparse
import re

import pytest

from tests.support.doctor_rig import (
    options,
)
from tests.support.doctor_surveys import (
    printed,
)
from twind import doctor
from twind.ctl.hint_options import HintOptions, command_hint
from twind.doctor import (
    report,
    runner,
)
from twind.doctor.check import (
    Devices,
    DoctorFinding,
    Fix,
    merge_findings,
)
from twind.doctor.report import add_commands
from twind.doctor.runner import DoctorReport

ROWS = runner.table()
HERE = HintOptions("--socket /tmp/a ", " --port main=/dev/x")
FIX = "twindctl --socket /tmp/a doctor --port main=/dev/x --fix"
# What moves, drops, wipes, burns or stops something where the diagnosis is wrong.
HARMFUL = re.compile(
    r"`twindctl (arm|disarm|reboot|adopt|register write)|`sudo systemctl (re)?start|`sudo systemctl mask|"
    r"`sudo (chown|chmod|chgrp|usermod|ip link set \S+ (up|down))|switch (it|its power) off|supply|unplug|"
    r"disconnect|cable|connector|end (it|the (other )?program)|chrt|vendor's tool|firmware|exchange|wires"
)
# Rows whose remedy has such a word and no such effect.
HARMLESS = {
    "PORT_DENIED": "the group lets the daemon open a port, which moves nothing",
    "NO_DAEMON": "a daemon that begins changes no torque",
}


def delay(id: int, *, fix: bool = True) -> DoctorFinding:
    thing = Devices("main", [(id, f"j{id}")])
    command = f"twindctl register write main {id} return_delay_time 5"
    mend = Fix("return_delay_time := 5 (is 250)", lambda: None, thing) if fix else None
    return DoctorFinding("RETURN_DELAY", thing, "500 us", "10 us", command, mend)


def test_harmful_remedy_has_a_caution() -> None:
    for code in (code for code, row in ROWS.items() if HARMFUL.search(row.remedy)):
        assert ROWS[code].caution or code in HARMLESS, code


def test_the_caution_is_printed_before_the_remedy_and_before_the_command() -> None:
    for code in (code for code, row in ROWS.items() if row.caution):
        said = printed(DoctorFinding(code, "thing", "measured", command="COMMAND", advice="ADVICE"))
        assert said.index(ROWS[code].caution) < said.index("ADVICE") < said.index("COMMAND"), code
        said = printed(DoctorFinding(code, "thing", "measured"))
        assert said.index(ROWS[code].caution) < said.index("do: "), code
        (data,) = report.data(DoctorReport(found=[DoctorFinding(code, "thing", "measured")]), ROWS, None)[
            "found"
        ]
        assert data["caution"] == ROWS[code].caution, code


def test_fix_dialog_prints_each_caution_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin.readline", lambda: "n\n")
    mends = [
        DoctorFinding("RETURN_DELAY", f"id {id}", "500 us", fix=Fix("delay := 5", lambda: None))
        for id in (1, 2)
    ]
    assert not doctor.confirm_fixes(DoctorReport(found=mends), ROWS, asks=True)
    assert capsys.readouterr().out.count(ROWS["RETURN_DELAY"].caution) == 1


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("twindctl disarm", "twindctl --socket /tmp/a disarm"),
        ("twindctl adopt l_knee", "twindctl --socket /tmp/a adopt --port main=/dev/x l_knee"),
        ("twindctl disarm\nsudo reboot", "twindctl --socket /tmp/a disarm\nsudo reboot"),
        ("twindctl scan --port /dev/x", "twindctl scan --port /dev/x"),
        ("twindctl --socket /run/b doctor", "twindctl --socket /run/b doctor"),
        ("twindctl check robot FILE", "twindctl check robot FILE"),
        ("twind", "twind --socket /tmp/a --port main=/dev/x"),
        ("sudo systemctl start twind", "sudo systemctl start twind"),
    ],
)  # fmt: skip
def test_a_command_keeps_the_options_of_the_call(text: str, printed: str) -> None:
    assert HERE.command(text) == printed
    assert HintOptions().command(text) == text


def test_hint_changes_only_quoted_commands_of_prose() -> None:
    said = "twindctl and twind differ: `twindctl reload` (not `sudo twind`)"
    assert (
        HERE.prose(said) == "twindctl and twind differ: `twindctl --socket /tmp/a reload` (not `sudo twind`)"
    )


def test_the_options_are_quoted_as_a_shell_takes_them() -> None:
    call = options("--robot", "my robot.yaml", "--port", "main=/dev/x", "--port", "b=/dev/y", "--config", "c")
    call.socket = None
    here = command_hint(call, "/run/it's")
    assert here.socket == """--socket '/run/it'"'"'s' """
    assert here.files == " --config c --robot 'my robot.yaml' --port main=/dev/x --port b=/dev/y"
    assert command_hint(argparse.Namespace(socket="/run/b"), "/run/c") == HintOptions("--socket /run/b ")


def test_without_daemon_the_fix_command_is_printed_once() -> None:
    found, fix = add_commands(
        [*merge_findings(map(delay, range(1, 25))), delay(30)], ROWS, HERE, daemon=False
    )
    assert fix == FIX and {each.command for each in found} == {FIX}
    said = report.text(DoctorReport(found=found, fix=fix), ROWS, None)
    assert said.count(FIX) == 1 and "twindctl register" not in said
    assert add_commands(found, ROWS, HERE, ["RETURN_DELAY"], daemon=False)[1] == f"{FIX} --only RETURN_DELAY"


def test_without_daemon_other_writes_advise_to_start_one() -> None:
    ((found,), fix) = add_commands([delay(7, fix=False)], ROWS, HERE, daemon=False)
    assert fix == "" and found.advice.startswith("a running daemon does it")
    assert found.command == "twindctl --socket /tmp/a register write main 7 return_delay_time 5"


def test_by_a_daemon_many_equal_writes_are_one_line_of_shell() -> None:
    (found,), _ = add_commands([*merge_findings(map(delay, range(1, 25)))], ROWS, HERE, daemon=True)
    ids = " ".join(map(str, range(1, 25)))
    assert found.command == (
        f"for id in {ids}; do twindctl --socket /tmp/a register write main $id return_delay_time 5; done"
    )
    apart = [delay(id) for id in (1, 2, 3)]
    assert [each.command.count("\n") for each in add_commands(apart, ROWS, HERE, daemon=True)[0]] == [0, 0, 0]


def test_every_remedy_carries_the_options_of_the_call() -> None:
    """Neither the remedies of rows nor those of findings: a bare command asks another daemon."""
    found, _ = add_commands([DoctorFinding(code, "x", "y") for code in ROWS], ROWS, HERE, daemon=True)
    said = report.text(DoctorReport(found=found), ROWS, None)
    bare = re.findall(r"`twindctl (?!--socket|check|scan --port)[a-z]+", said)
    assert bare == []


def test_command_for_another_daemon_is_unchanged() -> None:
    ask = DoctorFinding("PORT_HELD", "/dev/x", "held", advice="ask that one, `twindctl doctor`")
    assert add_commands([ask], ROWS, HERE, daemon=False) == ([ask], "")


def test_finding_about_all_servos_names_first_and_last_id() -> None:
    every, fix = add_commands([*merge_findings(map(delay, range(1, 25)))], ROWS, HERE, daemon=False)
    about = {
        "robot": "h24",
        "robot_by_default": False,
        "ports": {"main": "/dev/x"},
        "ids": {"main": list(range(1, 25))},
        "daemon": None,
    }
    said = report.text(DoctorReport(about=about, found=every, fix=fix), ROWS, None)
    assert "bus main ids 1-24 (all 24): 500 us" in said and "(j7)" not in said
    assert "`--fix` does it: bus main ids 1-24 (all 24): return_delay_time := 5" in said
    some, _ = add_commands([*merge_findings(map(delay, range(1, 24)))], ROWS, HERE, daemon=False)
    assert "23 (j23): 500 us" in report.text(DoctorReport(about=about, found=some), ROWS, None)


def test_equal_findings_about_many_servos_are_joined_with_one_fix() -> None:
    done: list[int] = []
    same = [
        DoctorFinding(
            "RETURN_DELAY",
            Devices("main", [(id, f"j{id}")]),
            "500 us",
            "10 us",
            f"write {id}",
            _fix(done, id),
        )
        for id in range(1, 6)
    ]
    apart = DoctorFinding("RETURN_DELAY", Devices("main", [(9, "j9")]), "500 us", "10 us", "write 9")
    one, other = merge_findings([*same, apart])
    assert one.thing == "bus main ids 1 (j1), 2 (j2), 3 (j3), 4 (j4), 5 (j5)"
    assert one.command.splitlines() == [f"write {id}" for id in range(1, 6)]
    assert one.fix is not None
    assert str(one.fix) == f"{one.thing}: delay := 5"
    one.fix.do()
    assert done == [1, 2, 3, 4, 5]
    assert other is apart, "what cannot be mended now is told apart"


def _fix(done: list[int], id: int) -> Fix:
    return Fix("delay := 5", lambda: done.append(id), Devices("main", [(id, f"j{id}")]))
