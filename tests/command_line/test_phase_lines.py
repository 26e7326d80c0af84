"""Each step of long work is a plain line with the time that is left, also where no terminal is."""

from argparse import Namespace
from io import StringIO

from twind.command_line.phase_lines import PhaseLines


def test_each_step_is_a_line_with_the_time_left_by_plan_then_by_the_time_that_passed() -> None:
    out = StringIO()
    times = iter((0.0, 10.0, 40.0, 70.0, 70.0, 100.0))
    report = PhaseLines(Namespace(json=False), "identify", out=out, now=lambda: next(times))
    report("moves pan (1 of 2)", 0.0, 120.0)
    report("moves tilt (2 of 2)", 0.25, 120.0)
    report("ends", 1.0)
    report("fits pan", 0.0)
    report("fits tilt", 0.5)
    assert out.getvalue().splitlines() == [
        "identify: moves pan (1 of 2), about 2:00 left",
        "identify: moves tilt (2 of 2), about 1:30 left",
        "identify: ends",
        "identify: fits pan",
        "identify: fits tilt, about 0:30 left",
    ]


def test_json_output_has_no_such_lines() -> None:
    out = StringIO()
    PhaseLines(Namespace(json=True), "identify", out=out)("fits pan", 0.0)
    assert out.getvalue() == ""
