"""Real-time tests of view fleet."""

import queue
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.daemon_stand_ins import Answers, answering, next_outcome
from tests.support.fleet_viewer_rig import known, without_loop
from tests.support.processes import until
from tests.support.viewer_messages import h24, other, state, status
from twind.client import ClientError
from twind.observe.viewing.fleet import fleet_viewer as show_module
from twind.observe.viewing.fleet import robot_registry as company_module
from twind.observe.viewing.fleet.fleet_page import Broadcast, FleetPage
from twind.observe.viewing.fleet.fleet_robot_place import FADED, FleetRobotPlace
from twind.observe.viewing.fleet.fleet_viewer import FleetViewer
from twind.observe.viewing.fleet.robot_health import GREY, standing
from twind.observe.viewing.fleet.robot_registry import RobotRegistry, Whose
from twind.observe.viewing.robot_connections import RobotConnections, local
from twind.observe.viewing.robot_scene import UNHEARD
from twind.observe.viewing.stop_threads import StopOutcome, StopThreads
from twind.observe.viewing.viewer_state import DaemonLost, RobotAnnounced, ViewerState
from twind_drivers.clock import FakeClock

SILENT = {"heard": False, "age_ms": 900.0}


@dataclass
class Folders:
    """Robots that answer on sockets of their own."""

    folder: Path
    ways: dict[str, RobotConnections]
    stack: list[Any]

    def robot(self, name: str, answers: Answers) -> Any:
        place = self.folder / name
        place.mkdir()
        context = answering(place)
        make = context.__enter__()
        self.stack.append(context)
        self.ways[name] = local(str(place))
        return make("observe", answers), make("control", answers)


@pytest.fixture
def folders(tmp_path: Path) -> Iterator[Folders]:
    made = Folders(tmp_path, {}, [])
    yield made
    for context in made.stack:
        context.__exit__(None, None, None)


def speaking(mode: str = "live") -> dict[str, Any]:
    """Answers of a robot that says one thing and hangs up."""
    done = {"parameters": {"state": "estop", "torque_off": True}}
    return {
        "GetRobot": {"parameters": h24()},
        "Monitor": {"parameters": status(mode=mode)},
        "EStop": done,
        "Cancel": done,
    }


def test_an_estop_of_all_waits_for_no_robot_that_hangs(folders: Folders) -> None:
    folders.robot("hangs", lambda method: None)
    answering_one, _ = folders.robot("answers", speaking().get)
    outcomes = queue.Queue[StopOutcome]()
    stops = {name: StopThreads(ways, bound=1.0) for name, ways in folders.ways.items()}
    Broadcast("e-stop", lambda: {name: each.estop for name, each in stops.items()}).ask(outcomes.put)
    until(lambda: answering_one.asked == ["EStop"], 1.0, "the one that does not hang was asked")
    assert outcomes.empty()
    failed = next_outcome(outcomes)
    total = next_outcome(outcomes)
    assert failed.title == "hangs: e-stop NOT confirmed" and "own switch" in failed.text
    assert (total.title, total.text) == ("e-stop: 1 of 2 robots", "not hangs")


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """The registry looks for robots more often than once a second."""
    monkeypatch.setattr(company_module, "LOOKED", 0.1)


@pytest.mark.usefixtures("often")
def test_a_lost_robot_stays_listed_and_a_later_one_is_added(folders: Folders) -> None:
    folders.robot("first", speaking().get)
    found: list[Mapping[Whose, RobotConnections]] = [{("first", "here"): folders.ways["first"]}]

    def look() -> Mapping[Whose, RobotConnections]:
        if not found:
            raise ClientError("no way there")
        return found[-1]

    company = RobotRegistry(look)
    until(lambda: [each.name for each in company.members] == ["first"], 5.0, "the first")
    folders.robot("second", speaking("mirror").get)
    found.append({("second", "here"): folders.ways["second"]})
    until(lambda: [each.name for each in company.members] == ["first", "second"], 5.0, "both")
    until(lambda: company.members[1].known.now().mode == "mirror", 5.0, "what it says")
    found.clear()
    until(lambda: company.problem == "no way there", 5.0, "why nobody is found")
    assert len(company.members) == 2
    company.close()
    assert not [each.name for each in threading.enumerate() if each.name.startswith("news of")]


@pytest.mark.usefixtures("often")
def test_a_robot_with_a_used_name_does_not_replace_the_first() -> None:
    """A stop that goes to somebody else than its name says would be worse than none."""
    unused = local("nowhere")
    found = {("h24", "/run/b"): unused, ("h24-mixed", "uplink"): unused}
    company = RobotRegistry(lambda: dict(sorted(found.items())))
    until(lambda: len(company.members) == 2, 5.0, "both")
    found[("h24", "/run/a")] = unused  # would come before it
    until(lambda: len(company.members) == 3, 5.0, "all")
    company.close()
    assert [each.name for each in company.members] == ["h24", "h24-mixed", "h24 (/run/a)"]


def test_a_page_lists_a_bounded_number_of_robots_and_reports_the_excess(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(company_module, "MOST", 2)
    company = RobotRegistry(lambda: {(f"h{number}", "nowhere"): local("nowhere") for number in range(5)})
    until(lambda: "more than 2" in company.problem, 5.0, "the page says so")
    company.close()
    assert [each.name for each in company.members] == ["h0", "h1"]


@pytest.fixture(scope="module")
def server() -> Iterator[Any]:
    pytest.importorskip("mjviser", reason="the extra `view` is not installed")
    from twind.observe.viewing.viewer_access import opened

    with opened(None, "test") as site:
        yield site.server


def bodies(server: Any, number: int, figure: str) -> list[Any]:
    """Frames of a figure of one robot."""
    names = (f"/robots/{number}/robot/{figure}/{body}" for body in range(30))
    found = (server.scene.get_handle_by_name(name) for name in names)
    return [each for each in found if each is not None]


def test_a_robot_that_is_lost_is_drawn_grey_where_it_was_and_as_it_is_when_it_is_back(server: Any) -> None:
    stand = FleetRobotPlace(server.scene, 0, "one")
    robot = known(status(), state(h24(), l_elbow=-0.5))
    stand.draw(robot.now(), standing(robot.now()))
    solid = server.scene.get_handle_by_name("/robots/0/robot/solid")
    marks = bodies(server, 0, "marks")
    assert solid.visible and not any(each.visible for each in marks)
    places = [tuple(each.position) for each in bodies(server, 0, "solid")]

    robot.take(DaemonLost("the link is cut"))
    how = standing(robot.now())
    assert how.kind in GREY
    stand.draw(robot.now(), how)
    assert not solid.visible and all(each.visible for each in marks)
    shells = [server.scene.get_handle_by_name(f"{each.name}/shell") for each in marks]
    assert {tuple(each.color) for each in shells} == {FADED}
    assert [tuple(each.position) for each in marks] == places

    robot.take(state(h24(), 1.0, head_pitch=SILENT))
    stand.draw(robot.now(), standing(robot.now()))
    red = [each for each, shell in zip(marks, shells, strict=True) if tuple(shell.color) == UNHEARD]
    assert solid.visible and [each for each in marks if each.visible] == red and len(red) == 1


def test_a_new_model_replaces_the_first_and_an_invalid_one_is_reported(server: Any) -> None:
    stand = FleetRobotPlace(server.scene, 1, "two")
    robot = known(status(), state(h24()))
    stand.draw(robot.now(), standing(robot.now()))
    large = stand.size
    robot.take(RobotAnnounced(other("<mujoco><nonsense/></mujoco>")))
    stand.draw(robot.now(), standing(robot.now()))
    assert "cannot be compiled" in stand.problem and bodies(server, 1, "solid") == []
    robot.take(RobotAnnounced(other()))
    stand.draw(robot.now(), standing(robot.now()))
    assert stand.problem == "" and len(bodies(server, 1, "solid")) == 2 and stand.size != large
    stand.failed(RuntimeError("no such mesh"))
    assert "no such mesh" in stand.problem and bodies(server, 1, "solid") == []


@dataclass
class Robots:
    """In place of a company: those that a test gives."""

    members: tuple[Any, ...]
    problem: str = ""


class RecordedPage(FleetPage):
    """A page whose words a test reads."""

    status_html: dict[str | None, str]

    def set_html(self, words: str, of: str | None = None) -> None:
        """Keep the text that the page shows."""
        super().set_html(words, of)
        self.words = {**getattr(self, "words", {}), of: words}


@pytest.fixture
def fleet(
    server: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> tuple[FleetViewer, RecordedPage, ViewerState]:
    """On a page that somebody looks at: one of another version, behind it one that is well."""
    well = known(status(), state(h24()), clock=FakeClock())
    unused = StopThreads(local(str(tmp_path)))
    pages = list[RecordedPage]()
    members = [SimpleNamespace(name="odd", known=without_loop(), stops=unused)]
    members += [SimpleNamespace(name="good", known=well, stops=unused)]
    monkeypatch.setattr(show_module, "RobotRegistry", lambda _: Robots(tuple(members)))
    monkeypatch.setattr(
        show_module, "FleetPage", lambda *given: pages.append(RecordedPage(*given)) or pages[-1]
    )
    monkeypatch.setattr(server, "get_clients", lambda: {0: SimpleNamespace(camera=SimpleNamespace())})
    return FleetViewer(server, dict), pages[0], well


def test_a_robot_with_invalid_messages_changes_no_text_of_the_others(
    fleet: tuple[FleetViewer, RecordedPage, ViewerState],
) -> None:
    shown, page_of, well = fleet
    for _ in range(4):
        shown.draw()
    assert "1 odd" in page_of.words[None] and "1 well" in page_of.words[None]
    well.take(status(state="estop"))
    for _ in range(3):
        shown.draw()
    assert "1 e-stop" in page_of.words[None] and "estop" in page_of.words["good"]
    assert "unreadable" in page_of.words["odd"]


def test_a_picture_that_fails_again_and_again_is_traced_once(
    fleet: tuple[FleetViewer, RecordedPage, ViewerState],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    def broken(*_: Any) -> None:
        raise RuntimeError("no such mesh")

    monkeypatch.setattr(FleetRobotPlace, "draw", broken)
    for _ in range(8):
        fleet[0].draw()
    assert capfd.readouterr().err.count("Traceback") == 2  # of each robot one
    assert "no such mesh" in fleet[1].words["good"]
