"""The table of joints: numbers, what is wrong with each in colour and in words, and columns that give way."""

from typing import Any

import pytest

from tests.support.picture_messages import NAMES, joints, view
from twind.ctl.dashboard.dashboard_renderer import plain
from twind.ctl.dashboard.joint_table import joints as table
from twind.ctl.dashboard.styled_lines import Line


def row(width: int = 120, *, armed: bool = True, **different: Any) -> tuple[str, Line, bool]:
    """Text, spans and urgency of the knee."""
    block = table(view(joints=joints(l_knee=different), armed=armed), width)
    shown = block.rows[NAMES.index("l_knee")]
    return plain([shown.line]), shown.line, shown.urgent


@pytest.mark.parametrize(
    ("different", "message", "style"),
    [
        ({"heard": False}, "SILENT", "bad"),
        ({"torque": False}, "LIMP", "bad"),
        ({"position": 3.1, "goal": 3.1}, "PAST LIMIT", "bad"),
        ({"position": -3.1, "goal": -3.1}, "PAST LIMIT", "bad"),
        ({"temperature": 60.0}, "warm", "warn"),
        ({"temperature": 70.0}, "HOT", "bad"),
        ({"voltage": 11.1}, "supply low", "warn"),
        ({"voltage": 10.5}, "SUPPLY LOW", "bad"),
        ({"faults": ["overload", "alert"]}, "overload, alert", "bad"),
        ({"calibrated": False, "verified": False}, "uncalibrated", "warn"),
        ({"verified": False}, "unverified", "warn"),
    ],
)
def test_a_joint_fault_is_shown_as_word_sign_and_colour(
    different: dict[str, Any], message: str, style: str
) -> None:
    shown, spans, urgent = row(**different)
    assert shown.endswith(message)
    assert shown[0] == {"bad": "!", "warn": "?"}[style]
    assert style in {each for _, each in spans}
    assert urgent


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("position", {0.0: " ", -0.099: " ", 0.1: "?", -0.1: "?", 0.199: "?", 0.2: "!", -0.2: "!"}),
        ("age_ms", {29.9: " ", 30.0: "?", 99.9: "?", 100.0: "!"}),
        ("temperature", {59.9: " ", 60.0: "?", 69.9: "?", 70.0: "!"}),
        ("voltage", {11.2: " ", 11.1: "?", 10.6: "?", 10.5: "!"}),
    ],
)
def test_a_number_catches_the_eye_from_its_bound_on(key: str, values: dict[float, str]) -> None:
    assert {value: row(**{"goal": 0.0, "position": 0.0, key: value})[0][0] for value in values} == values


@pytest.mark.parametrize(("mode", "error"), [("live", "-0.400"), ("mirror", "+0.010"), ("sim", "+0.010")])
def test_the_error_is_that_of_what_follows_the_goals(mode: str, error: str) -> None:
    """In mirror people hold the robot, and its simulation is what goals move."""
    told = joints(l_knee={"goal": 0.1, "position": 0.5, "simulated": 0.09})
    shown = table(view(joints=told, mode=mode), 120).rows[NAMES.index("l_knee")]
    assert f" {error} " in plain([shown.line])
    assert shown.urgent == (mode == "live")


def test_a_robot_that_is_not_armed_may_be_limp() -> None:
    assert "LIMP" not in row(armed=False, torque=False)[0]
    assert "off" in row(armed=False, torque=False)[0]


def test_a_simulation_needs_no_calibration() -> None:
    block = table(view(joints=joints(l_knee={"calibrated": False}), mode="sim"), 120)
    assert not any(row.urgent for row in block.rows)
    assert "uncalibrated" not in plain([row.line for row in block.rows])


def test_an_unknown_value_is_a_dash_and_no_warning() -> None:
    unknown = dict.fromkeys(
        ("position", "velocity", "effort", "goal", "temperature", "voltage", "age_ms", "torque", "verified")
    )
    said, _, urgent = row(**unknown)
    assert said.split() == ["l_knee", *"-" * 10]
    assert not urgent


def test_a_zero_has_no_sign() -> None:
    assert "-0.00" not in row(velocity=-0.001, effort=-0.004, goal=0.35, position=0.3501)[0]


@pytest.mark.parametrize(
    ("width", "titles"),
    [
        (200, "joint commanded measured error rad/s N·m °C V ms torque verified notes"),
        (100, "joint commanded measured error rad/s N·m °C V ms torque verified notes"),
        (90, "joint goal is error rad/s N·m °C V ms trq ver notes"),
        (80, "joint goal is error rad/s N·m °C ms trq notes"),
        (70, "joint goal is error rad/s °C ms trq notes"),
        (60, "joint goal is error °C trq notes"),
        (50, "joint is error °C notes"),
        (40, "joint is error"),
    ],
)
def test_columns_give_way_in_the_order_that_is_written_down(width: int, titles: str) -> None:
    shown = plain(table(view(), width).heads).split()
    assert shown[: len(titles.split())] == titles.split()


def test_torque_from_outside_has_a_column_where_the_daemon_estimates_it() -> None:
    for width, title in ((100, "outside"), (90, "ext")):
        told = joints(l_knee={"external_nm": -1.234, "external_sd_nm": 0.2, "contact": True})
        block = table(view(joints=told), width)
        lines = [plain([row.line]) for row in block.rows]
        assert title in plain(block.heads).split() and all(len(line) <= width for line in lines)
        knee = block.rows[NAMES.index("l_knee")]
        assert " -1.23 " in plain([knee.line]) and plain([knee.line]).endswith("contact")
        assert knee.urgent and sum(row.urgent for row in block.rows) == 1
    assert "outside" not in plain(table(view(), 200).heads)


def test_the_column_of_torque_from_outside_takes_the_room_of_less_important_ones() -> None:
    told = joints(l_knee={"external_nm": 0.0, "external_sd_nm": 0.2, "contact": False})
    heads = {width: plain(table(view(joints=told), width).heads).split() for width in (100, 80, 60)}
    assert " ".join(heads[100]) == "joint commanded measured error rad/s N·m outside °C V ms torque notes"
    assert " ".join(heads[80]) == "joint goal is error rad/s ext °C ms trq notes"
    assert " ".join(heads[60]) == "joint is error ext °C notes"


def test_a_bound_missing_in_the_robot_file_causes_no_warning() -> None:
    block = table(
        view(joints=[joints()[0] | {"name": "stranger", "temperature": 99.0, "position": 9.0, "goal": 9.0}]),
        99,
    )
    assert plain([block.rows[0].line])[0] == " "
