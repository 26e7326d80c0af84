"""Several robots on one page: how each is, where it stands, who stops it, that one troubles no other."""

import queue
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from answering import Answers, answering, told
from hypothesis import given
from hypothesis import strategies as st
from processes import until
from viewed import h24, other, state, status

from twind.client import ClientError
from twind.observe.viewing import status_html
from twind.observe.viewing import viewer_state as news_module
from twind.observe.viewing.fleet import fleet_viewer as show_module
from twind.observe.viewing.fleet import robot_registry as company_module
from twind.observe.viewing.fleet.broadcast import Broadcast
from twind.observe.viewing.fleet.fleet_page import FleetPage
from twind.observe.viewing.fleet.fleet_viewer import FleetViewer
from twind.observe.viewing.fleet.robot_health import GREY, HealthLevel, described, page, standing, summary
from twind.observe.viewing.fleet.robot_plate import FADED, RobotPlate, camera, spots
from twind.observe.viewing.fleet.robot_registry import RobotRegistry, Whose
from twind.observe.viewing.robot_connections import RobotConnections, local
from twind.observe.viewing.robot_scene import UNHEARD
from twind.observe.viewing.stop_threads import StopOutcome, StopThreads, Tell
from twind.observe.viewing.viewer_state import DaemonLost, News, RobotAnnounced, ViewerState
from twind_drivers.clock import FakeClock

SILENT = {"heard": False, "age_ms": 900.0}
FAULT = {"code": "FOLLOW_ERR", "message": "l_knee: too far off"}
BUS = {"name": "main", "port": "", "connected": False}


def known(*news: News, clock: FakeClock | None = None) -> ViewerState:
    """Of h24, then these."""
    made = ViewerState() if clock is None else ViewerState(clock.now)
    for each in (RobotAnnounced(h24()), *news):
        made.take(each)
    return made


@pytest.mark.parametrize(
    ("news", "kind", "said"),
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
        ((), HealthLevel.LOST, "nothing was heard yet"),
        ((status(),), HealthLevel.LOST, "nothing was heard yet"),
        ((state(h24()),), HealthLevel.LOST, "nothing was heard yet"),
    ],
)
def test_the_most_urgent_of_a_robot_is_what_is_said_of_it(
    news: tuple[News, ...], kind: HealthLevel, said: str
) -> None:
    how = standing(known(*news).now())
    assert (how.kind, how.said) == (kind, said)


def test_a_robot_that_is_silent_for_a_second_counts_as_old_whatever_it_said_last() -> None:
    clock = FakeClock()
    robot = known(status(faults=[FAULT]), state(h24()), clock=clock)
    clock.time = status_html.OLD - 0.1
    assert standing(robot.now()).kind is HealthLevel.FAULT
    clock.time = status_html.OLD
    assert standing(robot.now()).kind is HealthLevel.OLD
    robot.take(state(h24(), 1.0))
    assert standing(robot.now()).kind is HealthLevel.FAULT


def without_loop() -> ViewerState:
    """A robot of another version."""
    told_so = status(state="estop")
    del told_so["status"]["loop"]
    return known(told_so, state(h24()), clock=FakeClock())


def test_a_robot_that_says_what_nobody_understands_is_grey_and_counted_as_such() -> None:
    how, said = described(without_loop().now(), "")
    assert how.kind is HealthLevel.ODD and how.kind in GREY and "'loop'" in how.said and "loop" in said
    good = standing(known(status(), state(h24())).now())
    assert "1 odd" in summary([how, good]) and "1 well" in summary([how, good])


def test_a_stop_has_a_thread_once_somebody_asks_for_it(tmp_path: Path) -> None:
    before, outcomes = threading.active_count(), queue.Queue[StopOutcome]()
    stops = [StopThreads(local(str(tmp_path))) for _ in range(50)]
    assert threading.active_count() == before
    stops[0].estop.ask(outcomes.put)
    stops[0].estop.ask(outcomes.put)
    assert [told(outcomes).done, told(outcomes).done] == [False, False]


def test_what_is_kept_of_a_robot_whose_clock_stands_still_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_the_words_of_a_robot_name_its_faults_and_the_joints_that_are_not_heard() -> None:
    robot = known(status(faults=[FAULT]), state(h24(), l_knee=SILENT))
    said = page(robot.now(), standing(robot.now()), "")
    assert status_html.row("joints", "23 of 24 heard") in said
    assert status_html.row("not heard", "l_knee", status_html.RED) in said
    assert status_html.row("fault", "FOLLOW_ERR: l_knee: too far off", status_html.RED) in said


def test_of_a_robot_that_is_lost_only_its_last_words_are_told_as_such() -> None:
    robot = known(status(faults=[FAULT]), state(h24(), l_knee=SILENT), DaemonLost("the link is cut"))
    said = page(robot.now(), standing(robot.now()), "")
    assert status_html.row("now", "the link is cut", status_html.RED) in said
    assert status_html.row("said last", "live, armed, holding", status_html.GREY) in said
    assert "heard" not in said and "FOLLOW_ERR" in said


def test_the_sum_counts_each_kind_the_most_urgent_first() -> None:
    robots = [known(status(), state(h24())), known(), known(status(state="estop"), state(h24())), known()]
    said = summary(standing(each.now()) for each in robots)
    assert [said.find(each) for each in ("1 e-stop", "2 lost", "1 well")] == sorted(
        said.find(each) for each in ("1 e-stop", "2 lost", "1 well")
    )
    assert "none was found" in summary([])


@given(st.integers(1, 60), st.floats(0.3, 3.0))
def test_nobody_stands_nearer_to_another_than_asked_and_all_are_looked_at(count: int, apart: float) -> None:
    places = spots(count, apart)
    away = np.linalg.norm(places[:, None] - places[None], axis=2) + 1e9 * np.eye(count)
    assert away.min() >= apart - 1e-9
    where, what = camera(places, 0.5)
    assert (where[0] > places[:, 0]).all()  # in front of them
    assert places[:, 1].min() <= what[1] <= places[:, 1].max()


class Heard:
    """An errand that is answered when the test says so."""

    def __init__(self) -> None:
        self.tell: Tell | None = None

    def ask(self, tell: Tell) -> None:
        self.tell = tell

    def answer(self, *, done: bool) -> None:
        assert self.tell is not None
        self.tell(StopOutcome(done, "stopping" if done else "NOT stopped", "why"))


def test_all_are_asked_at_once_and_a_failure_is_told_before_the_last_has_answered() -> None:
    robots, outcomes = {name: Heard() for name in ("a", "b", "c")}, list[StopOutcome]()
    Broadcast("stop", lambda: robots).ask(outcomes.append)
    assert all(each.tell is not None for each in robots.values())
    robots["b"].answer(done=True)
    assert outcomes == []
    robots["c"].answer(done=False)
    assert outcomes == [StopOutcome(False, "c: NOT stopped", "why")]
    robots["a"].answer(done=True)
    assert outcomes[1:] == [StopOutcome(False, "stop: 2 of 3 robots", "not c")]


def test_that_all_did_it_is_told_once() -> None:
    robots, outcomes = {name: Heard() for name in ("a", "b")}, list[StopOutcome]()
    Broadcast("e-stop", lambda: robots).ask(outcomes.append)
    for each in robots.values():
        each.answer(done=True)
    assert outcomes == [StopOutcome(True, "e-stop: 2 of 2 robots", "all have answered")]


def test_a_press_that_reaches_nobody_is_no_success() -> None:
    outcomes = list[StopOutcome]()
    Broadcast("e-stop", dict).ask(outcomes.append)
    assert [each.done for each in outcomes] == [False]


# ---------------------------------------------------------------------------------------- with sockets


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


@pytest.mark.realtime
def test_an_estop_of_all_waits_for_no_robot_that_hangs(folders: Folders) -> None:
    folders.robot("hangs", lambda method: None)
    answering_one, _ = folders.robot("answers", speaking().get)
    outcomes = queue.Queue[StopOutcome]()
    stops = {name: StopThreads(ways, bound=1.0) for name, ways in folders.ways.items()}
    Broadcast("e-stop", lambda: {name: each.estop for name, each in stops.items()}).ask(outcomes.put)
    until(lambda: answering_one.asked == ["EStop"], 1.0, "the one that does not hang was asked")
    assert outcomes.empty()
    failed, total = told(outcomes), told(outcomes)
    assert failed.title == "hangs: e-stop NOT confirmed" and "own switch" in failed.text
    assert (total.title, total.text) == ("e-stop: 1 of 2 robots", "not hangs")


@pytest.mark.realtime
def test_who_is_gone_stays_and_who_comes_later_is_added(folders: Folders) -> None:
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


@pytest.mark.realtime
def test_who_is_called_as_another_takes_nobodys_place() -> None:
    """A stop that goes to somebody else than its name says would be worse than none."""
    unused = local("nowhere")
    found = {("h24", "/run/b"): unused, ("h24-mixed", "uplink"): unused}
    company = RobotRegistry(lambda: dict(sorted(found.items())))
    until(lambda: len(company.members) == 2, 5.0, "both")
    found[("h24", "/run/a")] = unused  # would come before it
    until(lambda: len(company.members) == 3, 5.0, "all")
    company.close()
    assert [each.name for each in company.members] == ["h24", "h24-mixed", "h24 (/run/a)"]


@pytest.mark.realtime
def test_a_page_has_room_for_so_many_robots_and_says_that_there_are_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(company_module, "MOST", 2)
    company = RobotRegistry(lambda: {(f"h{number}", "nowhere"): local("nowhere") for number in range(5)})
    until(lambda: "more than 2" in company.problem, 5.0, "the page says so")
    company.close()
    assert [each.name for each in company.members] == ["h0", "h1"]


# ---------------------------------------------------------------------------------------- drawn


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


@pytest.mark.realtime
def test_a_robot_that_is_lost_is_drawn_grey_where_it_was_and_as_it_is_when_it_is_back(server: Any) -> None:
    stand, robot = RobotPlate(server.scene, 0, "one"), known(status(), state(h24(), l_elbow=-0.5))
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


@pytest.mark.realtime
def test_another_model_takes_the_place_of_the_first_and_one_that_is_none_is_said(server: Any) -> None:
    stand, robot = RobotPlate(server.scene, 1, "two"), known(status(), state(h24()))
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


class Said(FleetPage):
    """A page whose words a test reads."""

    status_html: dict[str | None, str]

    def say(self, words: str, of: str | None = None) -> None:
        """What the page says now."""
        super().say(words, of)
        self.words = {**getattr(self, "words", {}), of: words}


@pytest.fixture
def fleet(
    server: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> tuple[FleetViewer, Said, ViewerState]:
    """On a page that somebody looks at: one of another version, behind it one that is well."""
    well = known(status(), state(h24()), clock=FakeClock())
    unused, pages = StopThreads(local(str(tmp_path))), list[Said]()
    members = [SimpleNamespace(name="odd", known=without_loop(), stops=unused)]
    members += [SimpleNamespace(name="good", known=well, stops=unused)]
    monkeypatch.setattr(show_module, "RobotRegistry", lambda _: Robots(tuple(members)))
    monkeypatch.setattr(show_module, "FleetPage", lambda *given: pages.append(Said(*given)) or pages[-1])
    monkeypatch.setattr(server, "get_clients", lambda: {0: SimpleNamespace(camera=SimpleNamespace())})
    return FleetViewer(server, dict), pages[0], well


@pytest.mark.realtime
def test_one_odd_robot_changes_no_word_of_the_others(fleet: tuple[FleetViewer, Said, ViewerState]) -> None:
    shown, page_of, well = fleet
    for _ in range(4):
        shown.draw()
    assert "1 odd" in page_of.words[None] and "1 well" in page_of.words[None]
    well.take(status(state="estop"))
    for _ in range(3):
        shown.draw()
    assert "1 e-stop" in page_of.words[None] and "estop" in page_of.words["good"]
    assert "cannot be understood" in page_of.words["odd"]


@pytest.mark.realtime
def test_a_picture_that_fails_again_and_again_is_traced_once(
    fleet: tuple[FleetViewer, Said, ViewerState],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    def broken(*_: Any) -> None:
        raise RuntimeError("no such mesh")

    monkeypatch.setattr(RobotPlate, "draw", broken)
    for _ in range(8):
        fleet[0].draw()
    assert capfd.readouterr().err.count("Traceback") == 2  # of each robot one
    assert "no such mesh" in fleet[1].words["good"]
