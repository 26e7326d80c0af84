"""Buses, hops and the lateness of ticks."""

import dataclasses
from typing import Any

import pytest

from tests.support.picture_messages import bus, loop, receive, view, watched
from twind.ctl.dashboard.dashboard_renderer import plain
from twind.ctl.dashboard.dashboard_state import MonitorCollector
from twind.ctl.dashboard.timing_blocks import BARS, buses, hops, lateness, merged


def bus_row(**different: Any) -> tuple[str, set[str], bool]:
    shown = buses(view(buses=[bus("upper", **different)]), 100).rows[0]
    return plain([shown.line]), {style for _, style in shown.line}, shown.urgent


@pytest.mark.parametrize(
    ("different", "word", "style"),
    [
        ({"connected": False}, "NOT CONNECTED", "bad"),
        ({"utilisation": 0.93}, "!93%", "warn"),
        ({"errors": 12}, " 12", "warn"),
        ({"warning": "a slow timer"}, " !", "warn"),
        ({"port": ""}, "no port", ""),
        ({"latency_ms": None, "latency_p99_ms": None}, "-     -", ""),
    ],
)
def test_a_bus_fault_is_shown_as_a_word_or_a_style(different: dict[str, Any], word: str, style: str) -> None:
    text, styles, _ = bus_row(**different)
    assert word in text
    assert style in styles


def test_a_bus_that_is_read_less_often_than_the_loop_runs_catches_the_eye_but_not_in_sim() -> None:
    one = view(buses=[bus("upper")])
    slow = dataclasses.replace(one, rates={"upper": 49.0})
    assert "! 49" in plain([buses(slow, 100).rows[0].line])
    assert one.status is not None
    sim = dataclasses.replace(slow, status={**one.status, "mode": "sim"})
    assert "!" not in plain([buses(sim, 100).rows[0].line])


def test_a_bus_that_a_simulation_never_opens_is_no_trouble() -> None:
    (row,) = buses(view(mode="sim", buses=[bus("upper", connected=False, port="")]), 100).rows
    assert "not opened" in plain([row.line])
    assert not row.urgent


def test_buckets_without_anything_at_the_ends_are_left_out_and_many_are_joined() -> None:
    assert merged([], 8) == []
    assert merged([{"upper_ms": 1.0, "count": 0}, {"upper_ms": None, "count": 0}], 8) == []
    many = [{"upper_ms": float(k), "count": int(3 <= k < 50)} for k in range(100)]
    rows = merged(many, BARS)
    assert len(rows) <= BARS
    assert sum(count for _, count in rows) == 47
    assert rows[0][0] is not None and rows[0][0] >= 3.0
    assert rows[-1][0] == 49.0
    assert merged([{"upper_ms": 1.0, "count": 2}, {"upper_ms": None, "count": 1}], 8) == [(1.0, 2), (None, 1)]


def test_values_not_yet_received_have_no_block() -> None:
    one = MonitorCollector()
    assert (
        hops(one.view(0.0), 80).full_height
        == lateness(one.view(0.0), 80).full_height
        == buses(one.view(0.0), 80).full_height
        == 0
    )
    known = watched()
    receive(known, "latency", [], 101.0)
    assert hops(known.view(101.0), 80).full_height == 0
    assert "longer, unknown" in plain([row.line for row in lateness(view(loop=odd()), 80).rows])


def odd() -> dict[str, Any]:
    return loop(lateness=[{"upper_ms": 1.0, "count": 5}, {"upper_ms": None, "count": 1}])
