"""The list of robots: known robots stay in it, and old values do not look like present ones."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.fleet import fleet_roster as roll_module
from twind.bridge.fleet.fleet_roster import UPLINK, FleetRoster
from twind.bridge.fleet.fleet_table import OLD, rows, to_json
from twind.ctl.dashboard.dashboard_renderer import plain


def answer(mode: str = "live", state: str = "armed", fresh: int = 24, **more: Any) -> dict[str, Any]:
    status = {
        "mode": mode,
        "state": state,
        "motion": "holding",
        "armed": True,
        "faults": [],
        "latency_ms": 2.5,
    }
    return {"status": status | more, "joints": [{"heard": place < fresh} for place in range(24)]}


def shown(roll: FleetRoster, now: float, width: int = 120) -> list[str]:
    return plain(rows(roll.robots(), now, width)).split("\n")


def test_a_roster_row_shows_mode_state_joints_faults_and_age() -> None:
    roll = FleetRoster()
    roll.update_status(
        "h1", UPLINK, answer(fresh=23, faults=[{"code": "BUS_LOST"}, {"code": "BUS_ERRORS"}]), 10.0, 0.02
    )
    head, row = shown(roll, 10.5)
    assert head.split() == ["robot", "where", "mode", "state", "motion", "joints", "faults", "latency", "age"]
    assert row.split("  ")[0] == "h1"
    for said in ("uplink", "live", "armed", "holding", "23/24", "BUS_LOST +1", "2.5 ms", "0.5 s"):
        assert said in row
    assert to_json(roll.robots()[0], 10.5) == {
        "name": "h1",
        "where": UPLINK,
        "lost": None,
        "odd": None,
        "age_s": 0.5,
        "mode": "live",
        "state": "armed",
        "motion": "holding",
        "armed": True,
        "heard": 23,
        "joints": 24,
        "faults": ["BUS_LOST", "BUS_ERRORS"],
        "latency_ms": 2.5,
        "way_ms": 20.0,
    }


def test_a_lost_robot_is_shown_with_the_reason_and_without_its_old_state() -> None:
    roll = FleetRoster()
    roll.update_status("h1", UPLINK, answer(), 10.0, 0.02)
    roll.mark_lost("h1", UPLINK, "its uplink ended")
    _, row, _, why = shown(roll, 100.0)
    assert "lost" in row and "armed" not in row and "live" in row and "2 min" in row
    assert why == "h1: its uplink ended"
    roll.update_status("h1", UPLINK, answer(), 101.0, 0.02)
    assert "armed" in shown(roll, 101.0)[1]


def test_a_simulated_robot_is_not_shown_as_disconnected() -> None:
    roll = FleetRoster()
    roll.update_status("h1", UPLINK, answer(mode="sim", state="disconnected"), 10.0, 0.02)
    roll.update_status("h2", UPLINK, answer(mode="mirror", state="disconnected"), 10.0, 0.02)
    _, simulated, mirrored = shown(roll, 10.0)
    assert "simulated" in simulated and "disconnected" not in simulated and "disconnected" in mirrored


def test_a_present_robot_without_an_answer_is_not_shown_with_its_old_state() -> None:
    roll = FleetRoster()
    roll.there("new", UPLINK)
    roll.update_status("old", UPLINK, answer(), 10.0, 0.02)
    _, new, old = shown(roll, 10.0 + OLD + 1.0)
    assert "no answer" in new
    assert "no answer" in old and "armed" not in old
    assert roll.has_unknown_robots()


def test_only_named_robots_are_listed_whether_present_or_lost() -> None:
    roll = FleetRoster(["h1", "h2"])
    roll.update_status("h2", UPLINK, answer(), 1.0, 0.0)
    roll.update_status("h3", UPLINK, answer(), 1.0, 0.0)
    first, second = roll.robots()
    assert (first.name, bool(first.lost)) == ("h1", True)
    assert (second.name, bool(second.lost)) == ("h2", False)


def test_two_ways_to_one_name_are_two_rows_that_of_this_machine_first() -> None:
    roll = FleetRoster()
    for where in (UPLINK, "/run/twind"):
        roll.update_status("h1", where, answer(), 1.0, 0.0)
    assert [each.where for each in roll.robots()] == ["/run/twind", UPLINK]


@given(
    st.lists(st.tuples(st.sampled_from("abcd"), st.sampled_from(["there", "told", "lost"])), max_size=30),
    st.integers(10, 200),
)
def test_every_known_robot_keeps_a_row_that_fits_the_width(
    happened: list[tuple[str, str]], width: int
) -> None:
    roll = FleetRoster()
    for now, (name, what) in enumerate(happened):
        if what == "there":
            roll.there(name, UPLINK)
        elif what == "told":
            roll.update_status(name, UPLINK, answer(), float(now), 0.0)
        else:
            roll.mark_lost(name, UPLINK, "gone")
    lines = shown(roll, 1e3, width)
    assert all(len(each) <= width for each in lines)
    known = sorted({name for name, _ in happened})
    assert [each.name for each in roll.robots()] == known
    last = dict(happened)
    assert {each.name for each in roll.robots() if each.lost} == {
        n for n, what in last.items() if what == "lost"
    }


GOOD = answer()
ODD: list[Any] = [
    None,
    [],
    "well",
    {},
    {"status": "well", "joints": []},
    {"status": {key: value for key, value in GOOD["status"].items() if key != "mode"}, "joints": []},
    answer(latency_ms="2"),
    answer(latency_ms=float("nan")),
    answer(faults=["x"]),
    answer(faults=None),
    answer(mode="x" * 100_000),
    GOOD | {"joints": None},
    GOOD | {"joints": [{}]},
]


@pytest.mark.parametrize("odd", ODD)
def test_an_odd_answer_marks_only_its_own_row(odd: Any) -> None:
    roll = FleetRoster()
    for name in ("a", "odd", "z"):
        roll.update_status(name, UPLINK, answer(), 10.0, 0.02)
    roll.update_status("odd", UPLINK, odd, 10.5, 0.02)
    roll.update_status("new", UPLINK, odd, 10.5, 0.02)
    _, first, new, row, last, _, *why = shown(roll, 10.5, 200)
    assert "armed" in first and "armed" in last
    assert "  odd  " in row and "  odd  " in new and "armed" not in row
    assert [each.split(":")[0] for each in why] == ["new", "odd"] and "cannot be decoded" in why[0]
    json.dumps([to_json(each, 10.5) for each in roll.robots()], allow_nan=False)
    assert not roll.has_unknown_robots()
    roll.update_status("odd", UPLINK, answer(), 11.0, 0.02)
    assert "armed" in shown(roll, 11.0, 200)[3]


def test_unknown_fields_from_a_newer_robot_are_not_odd() -> None:
    roll = FleetRoster()
    newer = answer(mood="good", faults=[{"code": "BUS_LOST", "since": 3.0}]) | {"weather": "fine"}
    roll.update_status("newer", UPLINK, newer, 10.0, 0.02)
    assert "BUS_LOST" in shown(roll, 10.0)[1] and roll.robots()[0].odd == ""


def test_no_more_robots_are_kept_than_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(roll_module, "MOST", 2)
    roll = FleetRoster()
    assert [roll.there(name, UPLINK) for name in ("a", "b", "c", "a")] == [True, True, False, True]
    roll.update_status("d", UPLINK, answer(), 1.0, 0.0)
    assert [each.name for each in roll.robots()] == ["a", "b"]
