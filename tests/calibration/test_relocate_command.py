"""`twindctl robot servo`: ids and rates before a robot file exists, planned before any write."""

from argparse import Namespace
from typing import Any

import pytest

from twind.command_line.verb import Rejected
from twind_drivers.servo_tools.adoption import relocate_command
from twind_drivers.servo_tools.adoption.relocate_command import planned_changes
from twind_drivers.servo_tools.family_tools import ServoLocation

MILLION = 1_000_000


def row(number: int, baud: int = 57_600, **more: Any) -> dict[str, Any]:
    found = {"kind": "dynamixel2", "id": number, "baud": baud, "model": 1020, "model_name": "XM430-W350"}
    return found | {"torque": False, "trouble": ""} | more


def test_a_known_id_is_searched_alone_and_all_ids_only_where_it_does_not_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[range | None] = []
    answers = {range(1, 4): [row(1)], range(8, 10): [], None: [row(5)]}

    def scan_rows(port: str, ids: range | None = None) -> tuple[list[dict[str, Any]], str]:
        asked.append(ids)
        return answers[ids], ""

    monkeypatch.setattr(relocate_command, "scan_rows", scan_rows)
    monkeypatch.setattr(relocate_command, "agreed", lambda *_: False)
    options = Namespace(port="p", id=1, new_id=3, baud=None, json=True, yes=True)
    with pytest.raises(Rejected, match="nothing was written"):
        relocate_command.relocate(options)
    assert asked == [range(1, 4)]
    options.id, options.new_id = 9, 8
    with pytest.raises(Rejected, match="no device has id 9; there are id 5"):
        relocate_command.relocate(options)
    assert asked[1:] == [range(8, 10), None]


def test_one_servo_alone_gets_the_new_id() -> None:
    (change,) = planned_changes([row(1)], number=None, new_id=7, baud=None)
    assert (change.place, change.home) == (ServoLocation(1, 57_600), ServoLocation(7, 57_600))


def test_after_an_interruption_the_same_command_finds_the_servo_at_its_new_id() -> None:
    (change,) = planned_changes([row(7), row(2)], number=1, new_id=7, baud=MILLION)
    assert (change.place, change.home) == (ServoLocation(7, 57_600), ServoLocation(7, MILLION))


def test_all_servos_get_the_rate_and_those_that_have_it_are_left() -> None:
    rows = [row(1), row(2, MILLION), row(3)]
    changes = planned_changes(rows, number=None, new_id=None, baud=MILLION)
    assert [each.home for each in changes] == [ServoLocation(1, MILLION), ServoLocation(3, MILLION)]


@pytest.mark.parametrize(
    ("rows", "wanted", "message"),
    [
        ([row(1), row(2)], {"new_id": 7}, "2 devices answer"),
        ([row(1), row(2)], {"number": 5, "new_id": 7}, "no device has id 5"),
        ([row(1), row(2)], {"number": 1, "new_id": 2}, "another servo is there"),
        ([row(1), row(2, MILLION)], {"number": 1, "new_id": 2, "baud": MILLION}, "another servo is there"),
        ([row(1), row(2)], {"number": 1, "new_id": 2, "baud": MILLION}, "another servo is there"),
        ([row(1), row(1, MILLION)], {"baud": MILLION}, "another servo is there"),
        ([row(1, trouble="two devices answer as this id")], {"new_id": 7}, "two devices"),
        ([row(1, torque=True)], {"new_id": 7}, "its torque is on"),
        ([row(1, model_name=None)], {"new_id": 7}, "maker's tool"),
        ([row(1)], {"new_id": 253}, "ids of dynamixel2 are 0 to 252"),
        ([row(1)], {"baud": 12_345}, "--baud 12345"),
    ],
)
def test_a_change_that_cannot_be_made_is_refused_before_a_write(
    rows: list[dict[str, Any]], wanted: dict[str, int], message: str
) -> None:
    with pytest.raises(Rejected, match=message):
        planned_changes(rows, **({"number": None, "new_id": None, "baud": None} | wanted))
