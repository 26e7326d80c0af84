"""Real-time tests of view news."""

import contextlib
import queue
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.daemon_stand_ins import Daemons, answering, next_outcome
from tests.support.processes import until
from tests.support.viewer_messages import h24, state, status
from twind.observe.viewing import robot_viewer
from twind.observe.viewing.daemon_messages import messages
from twind.observe.viewing.robot_connections import local
from twind.observe.viewing.robot_scene import AUTO
from twind.observe.viewing.stop_threads import StopThreads
from twind.observe.viewing.viewer_access import ViewerSite
from twind.observe.viewing.viewer_state import DaemonLost, News, RobotAnnounced, ViewerState


@pytest.fixture
def daemons(tmp_path: Path) -> Iterator[Daemons]:
    with answering(tmp_path) as make:
        yield make


def test_messages_go_on_after_one_that_is_none(daemons: Daemons, tmp_path: Path) -> None:
    answers: dict[str, Any] = {"GetRobot": {"parameters": h24()}, "Monitor": {"parameters": {"no": "topic"}}}
    daemons("observe", answers.get)
    ended = threading.Event()
    news = messages(local(str(tmp_path)), ended)
    found = [next(news) for _ in range(4)]
    assert isinstance(found[0], RobotAnnounced) and isinstance(found[3], RobotAnnounced)
    assert isinstance(found[2], DaemonLost) and "KeyError" in found[2].why
    ended.set()


class Canvas:
    """A server that somebody looks at, and a page; `set_html` keeps the texts."""

    def __init__(self) -> None:
        self.words: list[str] = []
        self.scene = None
        self.initial_camera = SimpleNamespace()
        self.draw = self._plot
        self.set_robot = lambda robot, *, jogs: None
        self.ghost = AUTO
        self.set_html = lambda words, alerts="": self.words.append(words)
        self.plotted = 0
        self.flush = self.atomic = contextlib.nullcontext

    def _plot(self) -> None:
        self.plotted += 1

    def get_clients(self) -> dict[int, Any]:
        return {1: SimpleNamespace(camera=SimpleNamespace())}


@pytest.mark.parametrize("broken", ["RobotModel", "camera"])
def test_a_picture_that_cannot_be_drawn_takes_no_button_with_it(
    daemons: Daemons, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    monkeypatch.setattr(robot_viewer, "RobotScene", lambda *_: SimpleNamespace(remove=lambda: None))
    monkeypatch.setattr(robot_viewer, broken, lambda next_outcome: {}["no such pose"])
    daemons("control", lambda method: {"parameters": {"state": "estop"}})
    stops = StopThreads(local(str(tmp_path)))
    outcomes = queue.Queue()
    known = ViewerState()
    canvas = Canvas()
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
        assert next_outcome(outcomes).done
    finally:
        ended.set()
        drawing.join(5.0)
    assert "the picture cannot be drawn: KeyError" in canvas.words[-1]
    assert canvas.plotted == 0


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
