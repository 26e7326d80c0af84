"""Several robots on one page: how each is, where it stands, who stops it, that one troubles no other."""

import queue
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.daemon_stand_ins import next_outcome
from tests.support.fleet_viewer_rig import known, without_loop
from tests.support.viewer_messages import h24, state, status
from twind.observe.viewing import status_html
from twind.observe.viewing import viewer_state as news_module
from twind.observe.viewing.fleet.fleet_page import Broadcast
from twind.observe.viewing.fleet.fleet_robot_place import camera, spots
from twind.observe.viewing.fleet.robot_health import (
    COLOURS,
    GREY,
    HealthLevel,
    described,
    page,
    standing,
    summary,
)
from twind.observe.viewing.robot_connections import local
from twind.observe.viewing.stop_threads import StopOutcome, StopThreads, Tell
from twind.observe.viewing.viewer_state import DaemonLost, News
from twind_drivers.clock import FakeClock


@pytest.mark.parametrize("level", HealthLevel)
def test_each_level_has_a_colour_for_the_page_and_the_scene(level: HealthLevel) -> None:
    assert len(status_html.rgb_of(COLOURS[level])) == 3


SILENT = {"heard": False, "age_ms": 900.0}
FAULT = {"code": "FOLLOW_ERR", "message": "l_knee: too far off"}
BUS = {"name": "main", "port": "", "connected": False}


@pytest.mark.parametrize(
    ("news", "kind", "text"),
    [
        ((status(), state(h24())), HealthLevel.WELL, "live, armed, holding"),
        ((status(motion="active"), state(h24())), HealthLevel.MOVING, "live, armed, active"),
        ((status(motion="streaming"), state(h24())), HealthLevel.MOVING, "live, armed, streaming"),
        ((status(), state(h24(), l_knee=SILENT)), HealthLevel.WARNED, "live, armed, holding"),
        ((status(), state(h24(), l_knee={"age_ms": None})), HealthLevel.WARNED, "live, armed, holding"),
        (
            (status(), state(h24(), l_knee={"faults": ["overload"]})),
            HealthLevel.WARNED,
            "live, armed, holding",
        ),
        ((status(buses=[BUS]), state(h24())), HealthLevel.WARNED, "live, armed, holding"),
        (
            (status(mode="sim", state="disconnected", buses=[BUS]), state(h24())),
            HealthLevel.WELL,
            "sim, holding",
        ),
        ((status(faults=[FAULT], motion="active"), state(h24())), HealthLevel.FAULT, "live, armed, active"),
        ((status(state="inhibited"), state(h24())), HealthLevel.FAULT, "live, inhibited, holding"),
        ((status(state="estop", faults=[FAULT]), state(h24())), HealthLevel.STOPPED, "live, estop, holding"),
        ((status(), state(h24()), DaemonLost("gone")), HealthLevel.LOST, "lost"),
        ((DaemonLost("never there"),), HealthLevel.LOST, "not reached"),
        ((), HealthLevel.LOST, "no message yet"),
        ((status(),), HealthLevel.LOST, "no message yet"),
        ((state(h24()),), HealthLevel.LOST, "no message yet"),
    ],
)
def test_the_status_of_a_robot_shows_its_most_urgent_condition(
    news: tuple[News, ...], kind: HealthLevel, text: str
) -> None:
    how = standing(known(*news).now())
    assert (how.kind, how.said) == (kind, text)


def test_a_robot_without_messages_for_a_second_counts_as_stale() -> None:
    clock = FakeClock()
    robot = known(status(faults=[FAULT]), state(h24()), clock=clock)
    clock.time = status_html.OLD - 0.1
    assert standing(robot.now()).kind is HealthLevel.FAULT
    clock.time = status_html.OLD
    assert standing(robot.now()).kind is HealthLevel.OLD
    robot.take(state(h24(), 1.0))
    assert standing(robot.now()).kind is HealthLevel.FAULT


def test_a_robot_with_unreadable_messages_is_grey_and_counted_as_odd() -> None:
    how, said = described(without_loop().now(), "")
    assert how.kind is HealthLevel.ODD and how.kind in GREY and "'loop'" in how.said and "loop" in said
    good = standing(known(status(), state(h24())).now())
    assert "1 odd" in summary([how, good]) and "1 well" in summary([how, good])


def test_a_stop_starts_its_thread_on_first_use(tmp_path: Path) -> None:
    before = threading.active_count()
    outcomes = queue.Queue[StopOutcome]()
    stops = [StopThreads(local(str(tmp_path))) for _ in range(50)]
    assert threading.active_count() == before
    stops[0].estop.ask(outcomes.put)
    stops[0].estop.ask(outcomes.put)
    assert [next_outcome(outcomes).done, next_outcome(outcomes).done] == [False, False]


def test_the_history_of_a_robot_with_a_stopped_clock_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(news_module, "KEPT", 5)
    robot = known(status())
    for _ in range(20):
        robot.take(state(h24()))
        robot.take({"topic": "latency", "time": 0.0, "latency": []})
    assert len(robot.path()) == len(robot.hops()) == 5


def test_no_word_of_any_robot_becomes_markup() -> None:
    evil = "<img src=x onerror=alert(1)>"
    finding = {"code": evil, "message": evil}
    event = {"topic": "events", "time": 0.0, "event": {"level": "error", "code": evil, "message": evil}}
    lease = {"holder": evil, "uid": 0, "expires_in": 1.0}
    told_evil = status(mode=evil, state=evil, motion=evil, lease=lease, faults=[finding])
    robot = known(told_evil, state(h24()), event)
    assert "<img" not in page(robot.now(), standing(robot.now()), evil)
    robot.take(DaemonLost(evil))
    assert "<img" not in page(robot.now(), standing(robot.now()), evil)


def test_the_robot_text_names_its_faults_and_stale_joints() -> None:
    robot = known(status(faults=[FAULT]), state(h24(), l_knee=SILENT))
    said = page(robot.now(), standing(robot.now()), "")
    assert status_html.row("joints", "23 of 24 heard") in said
    assert status_html.row("not heard", "l_knee", status_html.RED) in said
    assert status_html.row("fault", "FOLLOW_ERR: l_knee: too far off", status_html.RED) in said


def test_a_lost_robot_shows_only_its_last_state_marked_as_old() -> None:
    robot = known(status(faults=[FAULT]), state(h24(), l_knee=SILENT), DaemonLost("the link is cut"))
    said = page(robot.now(), standing(robot.now()), "")
    assert status_html.row("now", "the link is cut", status_html.RED) in said
    assert status_html.row("last state", "live, armed, holding", status_html.GREY) in said
    assert "heard" not in said and "FOLLOW_ERR" in said


def test_the_sum_counts_each_kind_the_most_urgent_first() -> None:
    robots = [known(status(), state(h24())), known(), known(status(state="estop"), state(h24())), known()]
    said = summary(standing(each.now()) for each in robots)
    assert [said.find(each) for each in ("1 e-stop", "2 lost", "1 well")] == sorted(
        said.find(each) for each in ("1 e-stop", "2 lost", "1 well")
    )
    assert "none was found" in summary([])


@given(st.integers(1, 60), st.floats(0.3, 3.0))
def test_robots_stand_at_least_the_given_distance_apart_and_all_are_in_view(count: int, apart: float) -> None:
    places = spots(count, apart)
    away = np.linalg.norm(places[:, None] - places[None], axis=2) + 1e9 * np.eye(count)
    assert away.min() >= apart - 1e-9
    where, what = camera(places, 0.5)
    assert (where[0] > places[:, 0]).all()  # in front of them
    assert places[:, 1].min() <= what[1] <= places[:, 1].max()


class PendingAction:
    """An action that the test answers later."""

    def __init__(self) -> None:
        self.tell: Tell | None = None

    def ask(self, tell: Tell) -> None:
        self.tell = tell

    def answer(self, *, done: bool) -> None:
        assert self.tell is not None
        self.tell(StopOutcome(done, "stopping" if done else "NOT stopped", "why"))


def test_a_broadcast_asks_all_robots_at_once_and_reports_a_failure_early() -> None:
    robots = {name: PendingAction() for name in ("a", "b", "c")}
    outcomes = list[StopOutcome]()
    Broadcast("stop", lambda: robots).ask(outcomes.append)
    assert all(each.tell is not None for each in robots.values())
    robots["b"].answer(done=True)
    assert outcomes == []
    robots["c"].answer(done=False)
    assert outcomes == [StopOutcome(False, "c: NOT stopped", "why")]
    robots["a"].answer(done=True)
    assert outcomes[1:] == [StopOutcome(False, "stop: 2 of 3 robots", "not c")]


def test_a_fully_successful_broadcast_is_reported_once() -> None:
    robots = {name: PendingAction() for name in ("a", "b")}
    outcomes = list[StopOutcome]()
    Broadcast("e-stop", lambda: robots).ask(outcomes.append)
    for each in robots.values():
        each.answer(done=True)
    assert outcomes == [StopOutcome(True, "e-stop: 2 of 2 robots", "all have answered")]


def test_a_broadcast_without_robots_is_no_success() -> None:
    outcomes = list[StopOutcome]()
    Broadcast("e-stop", dict).ask(outcomes.append)
    assert [each.done for each in outcomes] == [False]


# ---------------------------------------------------------------------------------------- with sockets


# ---------------------------------------------------------------------------------------- drawn
