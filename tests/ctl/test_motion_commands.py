"""`play` and `move` say by how much and why a motion took longer than its path."""

from typing import Any

import pytest

from twind.ctl.motion_commands import longer_text


def report(phase: str = "succeeded", **fields: Any) -> dict[str, Any]:
    return {"phase": phase, "duration": 9.0, **fields}


def test_a_slowed_motion_reports_its_time_and_its_reason() -> None:
    text = longer_text(report(stretch=1.2, stretched_by=["LOOKAHEAD_COLLISION"]))
    assert text == "; took 10.2 s instead of 9.0 s: slowed near other bodies (LOOKAHEAD_COLLISION)"


def test_a_motion_that_did_not_succeed_is_late() -> None:
    text = longer_text(report("cancelled", stretch=0.5, stretched_by=["OVERTEMP", "LOOP_LATE"]))
    assert text == "; 0.5 s late: slowed for a hot motor (OVERTEMP), ticks were missed (LOOP_LATE)"


def test_a_code_of_a_newer_daemon_stands_alone() -> None:
    assert longer_text(report(stretch=3.0, stretched_by=["NEW"])).endswith("instead of 9.0 s: NEW")


@pytest.mark.parametrize("fields", [{}, {"stretch": None}, {"stretch": 0.0}, {"stretch": 0.04}])
def test_a_motion_in_its_time_needs_no_word(fields: dict[str, Any]) -> None:
    assert longer_text(report(**fields)) == ""
    assert longer_text({"phase": "succeeded"}) == ""
