"""Blocks of the picture: lease, loop, latency, faults and refusals, in words as well as in colours."""

import dataclasses
from math import cos, radians, sin
from typing import Any

import pytest

from tests.support.picture_messages import bus, event, loop, receive, view, watched
from twind.ctl.dashboard.dashboard_blocks import (
    DashboardBlock,
    DashboardRow,
    ago,
    header,
    last_refusals,
    recorder,
    refusals,
    summary,
    trouble,
)
from twind.ctl.dashboard.dashboard_renderer import plain
from twind.ctl.dashboard.dashboard_state import DashboardState
from twind.ctl.dashboard.styled_lines import Line, line
from twind.ctl.reasons import remedy
from twind.robot.finding import ReasonCode


def text(block: DashboardBlock) -> str:
    return plain(block.shown(block.full_height))


def styles(lines: list[Line]) -> set[str]:
    return {style for each in lines for _, style in each}


@pytest.mark.parametrize("state", ["fault", "estop", "inhibited"])
def test_a_state_in_which_nothing_moves_is_an_alarm_in_words(state: str) -> None:
    shown = header(view(state=state), 80)
    assert f"!! {state.upper()} !!" in plain([shown])
    assert "alarm" in styles([shown])


def test_the_header_shows_robot_mode_and_urgent_conditions() -> None:
    assert plain([header(view(), 80)]).split() == ["h24", "LIVE", "armed", "active", "twind", "1.2.3"]
    said = plain([header(dataclasses.replace(view(inherited=True, state="connected"), lost=4), 120)])
    assert "! torque was found on" in said
    assert "! 4 news lost" in said
    assert "waiting" in plain([header(DashboardState(now=0.0), 80)])


def test_a_lost_daemon_is_shown_first_with_duration_and_cause() -> None:
    one = watched()
    one.record_disconnect("/run/twind/observe.sock: the daemon closed the connection", 101.0)
    said = text(trouble(one.view(104.2), 200))
    assert said.startswith("!! no daemon since 3 s; its last state is below (/run/twind/observe.sock:")


def test_a_daemon_without_messages_is_reported_after_a_while() -> None:
    assert text(trouble(watched().view(101.4), 80)) == ""
    assert text(trouble(watched().view(104.0), 80)) == "!! no news for 4 s"


def test_each_fault_has_its_reason_and_what_to_do_and_ports_are_warned_of() -> None:
    faults = [{"code": "OVERTEMP", "message": "l_knee: 82 °C"}, {"code": "NEW_ONE", "message": "odd"}]
    said = text(trouble(view(faults=faults, buses=[bus("main", warning="16 ms")]), 80)).splitlines()
    assert said == [
        " FAULT  OVERTEMP: l_knee: 82 °C",
        "   do: let it cool; reduce the load; then twindctl reset",
        " FAULT  NEW_ONE: odd",
        "   do: docs/reason-codes.md lists cause and remedy of NEW_ONE",
        "  WARN  main: 16 ms",
    ]


def test_long_reasons_go_on_below_and_lose_nothing() -> None:
    message = " ".join(f"word{k}" for k in range(40))
    shown = trouble(view(faults=[{"code": "ESTOP", "message": message}]), 60)
    said = text(shown)
    assert all(f"word{k}" in said for k in range(40))
    assert max(map(len, said.splitlines())) <= 60


def test_every_reason_code_has_a_remedy_that_fits_into_one_line() -> None:
    assert all(5 < len(remedy(code)) <= 90 for code in ReasonCode)


def test_a_lease_counts_down_between_the_news() -> None:
    one = watched()
    assert "uid 1000, pid 4242 · 0.83 s left" in text(summary(one.view(100.0), 80))
    assert "0.43 s left" in text(summary(one.view(100.4), 80))
    assert "0.00 s left" in text(summary(one.view(109.0), 80))
    assert "lease    free" in text(summary(view(lease=None), 80))


@pytest.mark.parametrize(
    ("share", "message", "style"),
    [(1.0, "on time 100%", "good"), (0.95, "! on time 95%", "warn"), (0.5, "! on time 50%", "bad")],
)
def test_ticks_that_are_late_now_are_seen_at_once(share: float, message: str, style: str) -> None:
    shown = summary(view(loop=loop(on_time=share)), 120)
    assert message in text(shown)
    assert style in styles([shown.rows[1].line])


def test_a_loop_without_real_time_priority_shows_the_cause() -> None:
    why = "Operation not permitted (LimitRTPRIO=40)"
    granted = loop(realtime={"scheduler": why})
    assert f"! {why}" not in text(summary(view(loop=granted), 200))
    assert f"! {why}" in text(summary(view(loop=granted | {"realtime_denied": ["scheduler"]}), 200))


def test_an_unknown_latency_is_a_dash() -> None:
    unknown = loop(late_p50_us=None, late_p99_us=None, late_max_us=None)
    said = text(summary(view(loop=unknown, latency_ms=None, latency_avg_ms=None, skew_ms=None), 120))
    assert "late p50/p99/max -/-/- µs" in said
    assert "now - ms" in said
    assert "between buses" not in said


def test_refusals_show_age_and_reason_with_the_newest_first() -> None:
    assert text(refusals(view(), 120)).splitlines()[1] == (
        "   12 s ago  POS_LIMIT: l_knee, point 0 (2 s): position 3 rad, bound 2.2 rad (and 1 more)"
    )
    one = watched()
    for k in range(9):
        receive(
            one,
            "verdicts",
            {"refusals": [{"code": "BUSY", "message": str(k)}], "warnings": [], "changes": []},
            100.0 + k,
        )
    assert len(last_refusals(one.view(110.0), 80).rows) == 5
    assert len(refusals(one.view(110.0), 80).rows) == 10


def test_the_recorder_block_shows_its_content_and_the_outcome_of_episodes() -> None:
    one = watched(flight={"span_s": 30.0, "bytes": 4_200_000, "last": "/var/lib/twind/x.flight"})
    receive(one, "events", event("EPISODE_BEGIN", "x", kind="begin", task="pour"), 98.0)
    assert text(recorder(one.view(100.0), 120)).splitlines() == [
        "flight   holds 30 s, 4.2 MB · last file /var/lib/twind/x.flight",
        "episode  pour runs for 2 s",
        "episode  pick the cup, 34 s long · success · 61 s ago",
    ]


def test_a_streamer_has_a_line_of_which_the_trouble_comes_first() -> None:
    well = {"name": "a", "endpoint": "http://x/in", "rate_hz": 99.6, "sent": 12, "waiting": 3}
    well |= {"dropped": 0, "dead": 0, "failures": 7, "error": None}
    said = text(recorder(watched(streams=[well, {**well, "dead": 2, "error": "refused"}]).view(100.0), 120))
    assert said.splitlines()[:2] == [
        "stream   100 Hz · 12 sent, 3 waiting · http://x/in",
        "stream   ! refused · ! 2 dead letters · 100 Hz · 12 sent, 3 waiting · http://x/in",
    ]


def test_a_name_with_escapes_in_it_moves_no_cursor() -> None:
    evil = "x\x1b[2J\r\nboom\u202e"
    said = view(robot=evil, lease={"holder": evil, "uid": 0, "expires_in": 1.0}, motion=evil)
    shown = plain([header(said, 200), *summary(said, 200).shown(9)])
    assert all(each.isprintable() for each in shown.splitlines())
    assert "x?[2J??boom?" in shown


def test_urgent_rows_come_first_where_not_all_have_room() -> None:
    rows = [DashboardRow(line(str(k)), urgent=k == 7) for k in range(9)]
    block = DashboardBlock("numbers", (line("head"),), rows, 3, scrolls=True)
    assert plain(block.shown(5)).splitlines() == [
        "head",
        "7",
        "0",
        "1",
        "  … 6 more numbers, up and down keys move",
    ]
    assert plain(block.shown(5, offset=4)).splitlines()[:4] == ["head", "7", "4", "5"]
    assert plain(block.shown(5, offset=99)).splitlines()[:4] == ["head", "7", "6", "8"]
    assert plain(block.shown(10, offset=4)).splitlines() == ["head", *map(str, range(9))]
    assert [len(block.shown(room)) for room in range(12)] == [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 10]


def test_a_duration_is_shown_in_readable_units() -> None:
    assert [ago(each) for each in (-1.0, 0.4, 119.0, 120.0, 7199.0, 7200.0)] == [
        *("0 s", "0 s", "119 s", "2 min", "119 min", "2 h"),
    ]


def leaning(**other: Any) -> DashboardState:
    """A robot that leans 20 degrees forward and a little to its right."""
    half = radians(10.0)
    turned = {"quaternion": [cos(half) * 0.998, 0.0634, sin(half) * 0.998, 0.0], "age_ms": 4.0}
    felt = {"gyro": [0.0, 0.3, 0.4], "acceleration": [-3.4, 0.0, 9.2]}
    one = watched()
    one.take({"topic": "state", "dropped": 0, "joints": [], "imu": turned | felt | other}, 101.0)
    return one.view(101.0)


def test_the_inclination_is_shown_if_an_imu_reports_it() -> None:
    said = text(summary(leaning(), 120))
    assert "imu      leans 21.3°" in said
    assert "pitch +19.9°" in said and "9.81 m/s², 0.50 rad/s" in said and "4 ms old" in said
    assert "imu" not in text(summary(view(), 120))


def test_a_stale_imu_shows_no_old_values() -> None:
    block = summary(leaning(age_ms=4200.0), 120)
    assert "imu      ! silent for 4 s: how it leans is not known" in text(block)
    assert "leans 21" not in text(block) and "rad/s" not in text(block)
    assert "warn" in styles(block.shown(block.full_height))
