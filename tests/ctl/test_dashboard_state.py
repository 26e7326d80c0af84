"""Collector of a daemon's messages: rates, refusals, episodes, and a lost daemon."""

import pytest

from tests.support.picture_messages import REFUSAL, bus, event, joints, loop, receive, robot, status, watched
from twind.ctl.dashboard.dashboard_state import KEPT, MonitorCollector


def test_until_status_and_joints_have_come_there_is_nothing_to_show() -> None:
    one = MonitorCollector()
    assert not one.is_complete
    receive(one, "status", status(), 1.0)
    assert not one.is_complete
    receive(one, "state", joints(), 1.0)
    assert one.is_complete
    assert one.view(1.0).joints == joints()


def test_the_rate_of_a_bus_is_counted_over_a_second_and_anew_after_a_restart() -> None:
    one = MonitorCollector()
    for now, exchanges in ((1.0, 1000), (1.5, 1049), (2.0, 1098)):
        receive(one, "status", status(buses=[bus("main", exchanges=exchanges)]), now)
    assert one.view(2.0).rates == {"main": pytest.approx(98.0)}
    one.record_disconnect("it ended", 2.5)
    receive(one, "status", status(buses=[bus("main", exchanges=7)]), 3.0)
    receive(one, "status", status(buses=[bus("main", exchanges=107)]), 4.0)
    assert one.view(4.0).rates == {"main": pytest.approx(100.0)}


def test_a_histogram_sent_once_a_second_stays_until_the_next() -> None:
    one = watched()
    before = one.view(100.0).lateness
    assert before
    receive(one, "status", status(loop=loop(lateness=None)), 100.1)
    assert one.view(100.1).lateness == before


def test_refusals_are_kept_the_newest_first_and_an_accepted_trajectory_is_none() -> None:
    one = MonitorCollector()
    for number in range(KEPT + 5):
        finding = {"code": "BUSY", "message": str(number)}
        receive(one, "verdicts", {"refusals": [finding], "warnings": [], "changes": []}, float(number))
    receive(one, "verdicts", {"refusals": [], "warnings": REFUSAL["refusals"], "changes": []}, 99.0)
    seen = one.view(99.0).refusals
    assert [(each.at, each.text) for each in seen[:2]] == [(24.0, "BUSY: 24"), (23.0, "BUSY: 23")]
    assert len(seen) == KEPT


def test_an_episode_lasts_from_its_mark_to_its_end_and_an_end_without_one_is_none() -> None:
    one = MonitorCollector()
    receive(one, "events", event("EPISODE_END", "x", kind="end", success=True), 1.0)
    receive(one, "events", event("EPISODE_BEGIN", "x", kind="begin", task="pour"), 2.0)
    receive(one, "events", event("NOTE", "hm", kind="note"), 3.0)
    (running,) = one.view(3.0).episodes
    assert (running.task, running.begin, running.end) == ("pour", 2.0, None)
    receive(one, "events", event("EPISODE_END", "x", kind="end", success=False), 5.0)
    (ended,) = one.view(5.0).episodes
    assert (ended.task, ended.begin, ended.end, ended.success) == ("pour", 2.0, 5.0, False)
    assert len(one.view(5.0).events) == 4


def test_an_episode_ends_with_the_next_ones_begin_and_with_its_daemon() -> None:
    one = MonitorCollector()
    for now, task in ((1.0, "a"), (2.0, "b")):
        receive(one, "events", event("EPISODE_BEGIN", task, kind="begin", task=task), now)
    receive(one, "events", event("EPISODE_END", "b", kind="end", success=True), 3.0)
    assert [(each.task, each.end, each.success) for each in one.view(3.0).episodes] == [
        ("b", 3.0, True),
        ("a", 2.0, None),
    ]
    receive(one, "events", event("EPISODE_BEGIN", "c", kind="begin", task="c"), 4.0)
    one.record_disconnect("it ended", 5.0)
    assert one.view(6.0).episodes[0].end == 5.0


def test_a_lost_daemon_is_gone_since_the_first_failure_and_back_with_the_next_message() -> None:
    one = watched()
    one.record_disconnect("it hung up", 101.0)
    one.record_disconnect("no such socket", 102.0)
    seen = one.view(104.0)
    assert (seen.gone, seen.gone_since) == ("it hung up", 101.0)
    assert seen.joints  # what it said last
    receive(one, "state", joints(), 105.0)
    assert one.view(105.0).gone == ""


def test_lost_news_add_up_and_changes_are_counted() -> None:
    one = watched()
    before = one.count
    one.take({"topic": "state", "dropped": 3, "joints": joints()}, 101.0)
    one.take({"topic": "state", "dropped": 4, "joints": joints()}, 101.1)
    assert one.view(101.1).lost == 7
    assert one.count == before + 2


def test_bounds_come_from_the_robots_file_and_what_it_leaves_out_is_never_reached() -> None:
    one = MonitorCollector()
    one.robot(robot())
    known = one.view(0.0).bounds["l_knee"]
    assert (known.lower, known.warm, known.hot, known.low, known.flat) == (-3.0, 60.0, 70.0, 11.1, 10.5)
    one.robot({"joints": [{"name": "x", "type": {"heat": None}}]})
    assert not one.view(0.0).bounds["x"].hot <= 1e9


def test_a_topic_that_is_newer_than_this_program_changes_nothing() -> None:
    one = watched()
    one.take({"topic": "weather", "dropped": 0, "weather": {}}, 100.0)
    assert one.view(100.0) == watched().view(100.0)


def test_fields_missing_from_an_older_daemon_are_accepted() -> None:
    one = MonitorCollector()
    old = status()
    del old["flight"], old["skew_ms"]
    del old["loop"]["lateness"]
    receive(one, "status", old, 1.0)
    marked = event("NOTE", "x")
    del marked["annotation"]
    receive(one, "events", marked, 1.0)
    assert one.view(1.0).lateness == ()
