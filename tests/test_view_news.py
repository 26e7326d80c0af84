"""What the viewer is told: what it keeps of it, how old that is, and that nothing said ends the telling."""

import contextlib
import queue
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from answering import Daemons, answering, told
from processes import until
from viewed import h24, other, state, status

from twind.observe.viewing import robot_viewer, status_html
from twind.observe.viewing.daemon_messages import messages
from twind.observe.viewing.robot_connections import local
from twind.observe.viewing.robot_scene import AUTO
from twind.observe.viewing.stop_threads import StopThreads
from twind.observe.viewing.viewer_access import ViewerSite
from twind.observe.viewing.viewer_state import WINDOW, DaemonLost, News, RobotAnnounced, ViewerState
from twind_drivers.clock import FakeClock


@pytest.fixture
def daemons(tmp_path: Path) -> Iterator[Daemons]:
    with answering(tmp_path) as make:
        yield make


@pytest.mark.realtime
def test_messages_go_on_after_one_that_is_none(daemons: Daemons, tmp_path: Path) -> None:
    answers: dict[str, Any] = {"GetRobot": {"parameters": h24()}, "Monitor": {"parameters": {"no": "topic"}}}
    daemons("observe", answers.get)
    ended = threading.Event()
    news = messages(local(str(tmp_path)), ended)
    found = [next(news) for _ in range(4)]
    assert isinstance(found[0], RobotAnnounced) and isinstance(found[3], RobotAnnounced)
    assert isinstance(found[2], DaemonLost) and "KeyError" in found[2].why
    ended.set()


def test_a_message_that_is_none_is_said_and_the_next_one_is_shown() -> None:
    known, robot = ViewerState(), h24()
    seen: list[tuple[str | None, bool]] = []

    def news() -> Iterator[News]:
        for each in (RobotAnnounced(robot), {"topic": "state"}, state(robot, 1.0)):
            yield each
            seen.append((known.now().lost, known.now().joints is not None))
        raise OSError("the file is gone")

    robot_viewer.take(known, news())
    assert seen[0] == (None, False)
    assert "KeyError" in str(seen[1][0]) and not seen[1][1]
    assert seen[2] == (None, True)
    assert known.now().lost == "the messages have ended: OSError: the file is gone"


def test_the_age_of_what_is_seen_is_said_and_red_from_a_second_on() -> None:
    clock = FakeClock()
    known, robot = ViewerState(clock.now), h24()
    assert "s ago" not in status_html.page(known.now(), None, None, 0)
    known.take(state(robot))
    clock.time = 0.9
    assert "less than 1 s ago" in status_html.page(known.now(), None, None, 0)
    clock.time = 12.0
    said = status_html.page(known.now(), None, None, 0)
    assert status_html.row("heard", "12 s ago: the picture is old", status_html.RED) in said
    known.take(status())  # says nothing of joints
    assert "12 s ago" in status_html.page(known.now(), None, None, 0)


class Canvas:
    """A server that somebody looks at, and a page; `say` keeps the words."""

    def __init__(self) -> None:
        self.words: list[str] = []
        self.scene, self.initial_camera = None, SimpleNamespace()
        self.plots, self.ghost, self.say = SimpleNamespace(draw=self._plot, of=id), AUTO, self.words.append
        self.plotted = 0
        self.flush = self.atomic = contextlib.nullcontext

    def _plot(self) -> None:
        self.plotted += 1

    def get_clients(self) -> dict[int, Any]:
        return {1: SimpleNamespace(camera=SimpleNamespace())}


@pytest.mark.realtime
@pytest.mark.parametrize("broken", ["Likeness", "camera"])
def test_a_picture_that_cannot_be_drawn_takes_no_button_with_it(
    daemons: Daemons, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    monkeypatch.setattr(robot_viewer, "RobotScene", lambda *_: SimpleNamespace(remove=lambda: None))
    monkeypatch.setattr(robot_viewer, broken, lambda told: {}["no such pose"])
    daemons("control", lambda method: {"parameters": {"state": "estop"}})
    stops, outcomes, known, canvas = StopThreads(local(str(tmp_path))), queue.Queue(), ViewerState(), Canvas()
    for news in (RobotAnnounced(h24()), status(), state(h24())):
        known.take(news)
    ended = threading.Event()
    shown = robot_viewer.RobotViewer(ViewerSite(canvas, ""), known, canvas)
    drawing = threading.Thread(target=robot_viewer.run, args=(shown, known, (), ended))
    drawing.start()
    try:
        until(lambda: any("mode live" in each for each in canvas.words), 5.0, "the words")
        assert drawing.is_alive()
        stops.estop.ask(outcomes.put)
        assert told(outcomes).done
    finally:
        ended.set()
        drawing.join(5.0)
    assert "the picture cannot be drawn: KeyError" in canvas.words[-1]
    assert canvas.plotted == 0


@pytest.mark.realtime
def test_messages_go_on_when_a_daemon_comes_back(daemons: Daemons, tmp_path: Path) -> None:
    ended = threading.Event()
    news = messages(local(str(tmp_path)), ended)
    assert isinstance(next(news), DaemonLost)
    answers = {"GetRobot": {"parameters": h24()}, "Monitor": {"parameters": status()}}
    daemons("observe", answers.get)
    found: list[News] = [next(news), next(news), next(news)]
    assert isinstance(found[0], RobotAnnounced)
    assert isinstance(found[2], RobotAnnounced)  # the stream ended, and it asked anew
    ended.set()


def test_what_is_known_is_the_latest_and_no_older_than_its_window() -> None:
    known, robot = ViewerState(), h24()
    known.take(RobotAnnounced(robot))
    for step in range(40):
        known.take(state(robot, 0.5 * step, head_yaw=0.01 * step))
    path = known.path()
    assert path[-1].measured[0] == pytest.approx(0.39)
    assert path[-1].time - path[0].time <= WINDOW
    known.take(state(robot, 0.0))  # a recording that began anew
    assert [each.time for each in known.path()] == [0.0]
    known.take(RobotAnnounced(other()))
    assert known.now().joints is None and known.path() == []


def test_only_refusals_warnings_and_errors_are_kept() -> None:
    known = ViewerState()
    good: dict[str, Any] = {"refusals": [], "warnings": [], "changes": []}
    bad = good | {"refusals": [{"code": "POS_LIMIT", "message": "too far"}]}
    for time, verdict in enumerate((good, bad)):
        known.take({"topic": "verdicts", "time": float(time), "verdict": verdict})
    for level in ("info", "warning"):
        event = {"level": level, "code": "X", "message": "m"}
        known.take({"topic": "events", "time": 0.0, "event": event})
    known.take({"topic": "trajectories", "time": 0.0, "accepted": {}})  # of a newer daemon
    assert [each["time"] for each in known.now().refusals] == [1.0]
    assert [each["event"]["level"] for each in known.now().events] == ["warning"]


def test_a_joint_is_old_where_its_age_says_so_or_is_not_known() -> None:
    known, robot = ViewerState(), h24()
    silent = {"heard": False, "age_ms": 900.0}
    known.take(state(robot, head_yaw={"age_ms": 90.0}, head_pitch={"age_ms": None}, l_elbow=silent))
    now = known.now()
    assert now.joints is not None
    old = [joint["name"] for joint, each in zip(robot["robot"]["joints"], now.stale, strict=True) if each]
    assert old == ["head_yaw", "head_pitch"]  # who is not heard at all is marked as that
