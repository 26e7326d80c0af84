"""The viewer without a browser: what it knows, what it says, where bodies are drawn, who may move it."""

import contextlib
import json
import queue
import socket
import threading
from argparse import Namespace
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import until
from viewed import GROUP_THREE, h24, other, state, status

from twind.ctl import demo_viewer
from twind.ctl.verb import UsageError
from twind.observe import view
from twind.observe.viewing import plots, viewer, words
from twind.observe.viewing.door import Site
from twind.observe.viewing.figure import shown_geoms
from twind.observe.viewing.likeness import Likeness, NoLikeness
from twind.observe.viewing.live import messages
from twind.observe.viewing.news import WINDOW, Described, Known, Lost, News
from twind.observe.viewing.operate import Operator, arm, look_after
from twind.observe.viewing.scene import AUTO, BOTH, NONE, ghosts
from twind.observe.viewing.stops import Outcome, Stops
from twind_drivers.clock import FakeClock

LEASE = {"holder": "uid 0, pid 1", "uid": 0, "expires_in": 1.0}
Answers = Callable[[str], Any]


class Daemon:
    """Answers calls as it is told: parameters, an exception's name, or None: never. `asked`: the methods."""

    def __init__(self, path: Path, answers: Answers) -> None:
        self.asked: list[str] = []
        self.ended: queue.Queue[str] = queue.Queue()  # a connection was closed
        self._answers, self._socket = answers, socket.socket(socket.AF_UNIX)
        self._socket.bind(str(path))
        self._socket.listen()
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._socket.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        buffer = b""
        with client:
            while data := client.recv(65536):
                buffer += data
                while b"\0" in buffer:
                    message, _, buffer = buffer.partition(b"\0")
                    method = json.loads(message)["method"].rpartition(".")[2]
                    self.asked.append(method)
                    answer = self._answers(method)
                    if answer is not None:
                        client.sendall(json.dumps(answer).encode() + b"\0")
        self.ended.put("closed")

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def daemons(tmp_path: Path) -> Iterator[Callable[[str, Answers], Daemon]]:
    made: list[Daemon] = []

    def make(name: str, answers: Answers) -> Daemon:
        made.append(Daemon(tmp_path / f"{name}.sock", answers))
        return made[-1]

    yield make
    for each in made:
        each.close()


def told(outcomes: "queue.Queue[Outcome]", seconds: float = 5.0) -> Outcome:
    return outcomes.get(timeout=seconds)


# ---------------------------------------------------------------------------------------- stops


@pytest.mark.realtime
def test_an_estop_waits_for_no_stop_that_hangs(daemons: Any, tmp_path: Path) -> None:
    daemons("control", lambda method: None)
    daemons("observe", lambda method: {"parameters": {"state": "estop", "torque_off": True, "done": True}})
    stops, stop, estop = Stops(str(tmp_path), bound=1.0), queue.Queue(), queue.Queue()
    stops.stop.ask(stop.put)
    stops.estop.ask(estop.put)
    assert told(estop, 0.9) == Outcome(True, "e-stop", "state estop, torque is off")
    assert stop.empty()
    late = told(stop)
    assert not late.done
    assert "no answer from the daemon within 1 s" in late.text


@pytest.mark.realtime
def test_an_estop_goes_by_whichever_socket_there_is_and_says_when_there_is_none(
    daemons: Any, tmp_path: Path
) -> None:
    stops, outcomes = Stops(str(tmp_path), bound=1.0), queue.Queue()
    stops.estop.ask(outcomes.put)
    none = told(outcomes)
    assert (none.done, none.title) == (False, "e-stop NOT confirmed") and "own switch" in none.text
    control = daemons("control", lambda method: {"parameters": {"state": "estop", "torque_off": None}})
    stops.estop.ask(outcomes.put)
    assert told(outcomes).done
    assert control.asked == ["EStop"]


@pytest.mark.realtime
@pytest.mark.parametrize("observe", [{"parameters": {}}, {"error": 7}, {"error": "x.y.Busy"}, [1]])
def test_an_estop_goes_by_the_other_socket_where_one_answers_rubbish(
    daemons: Any, tmp_path: Path, observe: Any
) -> None:
    daemons("observe", lambda method: observe)
    daemons("control", lambda method: {"parameters": {"state": "estop", "torque_off": False}})
    outcomes: queue.Queue[Outcome] = queue.Queue()
    Stops(str(tmp_path), bound=1.0).estop.ask(outcomes.put)
    assert told(outcomes) == Outcome(True, "e-stop", "state estop, torque is on")


@pytest.mark.realtime
def test_a_stop_button_outlives_rubbish_and_tabs_that_cannot_be_told(daemons: Any, tmp_path: Path) -> None:
    answers: dict[str, Any] = {"Cancel": {"parameters": {}}, "EStop": {"parameters": {"torque_off": 7}}}
    daemons("control", answers.get)
    stops, outcomes = Stops(str(tmp_path), bound=1.0), queue.Queue()

    def no_tab(outcome: Outcome) -> None:
        raise RuntimeError("the tab was closed")

    for errand in (stops.stop, stops.estop):
        errand.ask(no_tab)
        errand.ask(outcomes.put)
        failed = told(outcomes)
        assert not failed.done and failed.title == f"{errand.name} NOT confirmed"
        assert "use its own switch" in failed.text
    answers |= {method: {"parameters": {"state": "estop"}} for method in answers}
    for errand in (stops.stop, stops.estop):
        errand.ask(outcomes.put)
        assert told(outcomes).done


@pytest.mark.realtime
def test_who_may_not_stop_is_told_what_may(daemons: Any, tmp_path: Path) -> None:
    refusal = {
        "error": "io.twind.Control.NotAllowed",
        "parameters": {"role": "observer", "method": "Cancel"},
    }
    daemons("control", lambda method: refusal)
    outcomes: queue.Queue[Outcome] = queue.Queue()
    Stops(str(tmp_path)).stop.ask(outcomes.put)
    answer = told(outcomes)
    assert not answer.done and "e-stop needs no operator" in answer.text


# ---------------------------------------------------------------------------------------- the lease


@pytest.mark.realtime
def test_the_lease_is_one_tabs_and_ends_with_it(daemons: Any, tmp_path: Path) -> None:
    daemon = daemons("control", lambda method: {"parameters": {"joints": []}})
    holders: queue.Queue[int | None] = queue.Queue()
    operator, outcomes = Operator(str(tmp_path), holders.put), queue.Queue()
    operator.call(1, arm, outcomes.put)
    assert not told(outcomes).done  # nobody took it
    assert daemon.asked == []
    operator.take(1, outcomes.put)
    assert told(outcomes).title == "lease taken"
    assert holders.get(timeout=5.0) == 1
    operator.take(2, outcomes.put)
    assert not told(outcomes).done
    operator.call(2, arm, outcomes.put)
    assert not told(outcomes).done
    assert "Arm" not in daemon.asked
    operator.call(1, arm, outcomes.put)
    assert told(outcomes).title == "armed"
    operator.left(1)
    assert holders.get(timeout=5.0) is None
    assert daemon.ended.get(timeout=5.0) == "closed"
    assert {"AcquireLease", "RenewLease"} <= set(daemon.asked)


@pytest.mark.realtime
def test_what_is_asked_meanwhile_is_refused_and_never_done_later(daemons: Any, tmp_path: Path) -> None:
    going_on, begun = threading.Event(), threading.Event()

    def answers(method: str) -> Any:
        if method == "Arm":
            begun.set()
            going_on.wait(5.0)
        return {"parameters": {"joints": []}}

    daemon = daemons("control", answers)
    operator, outcomes = Operator(str(tmp_path), lambda tab: None), queue.Queue()
    operator.take(1, outcomes.put)
    assert told(outcomes).done
    operator.call(1, arm, outcomes.put)
    assert begun.wait(5.0)
    operator.call(1, lambda client: Outcome(True, "played", ""), outcomes.put)
    assert told(outcomes).text == "what was asked before is still being done"
    going_on.set()
    assert told(outcomes).title == "armed"
    assert outcomes.empty() and daemon.asked.count("Arm") == 1


@pytest.mark.realtime
def test_a_page_that_does_not_answer_loses_the_lease(daemons: Any, tmp_path: Path) -> None:
    daemon = daemons("control", lambda method: {"parameters": {}})
    operator, outcomes = Operator(str(tmp_path), lambda tab: None), queue.Queue()
    operator.take(1, outcomes.put)
    assert told(outcomes).done
    answers = iter([RuntimeError("it may not read what it keeps"), TimeoutError("nothing came")])

    def ask() -> None:
        raise next(answers)

    look_after(operator, 1, ask)
    assert daemon.ended.get(timeout=5.0) == "closed"
    operator.take(1, outcomes.put)  # it came back, and asks anew
    assert told(outcomes).done


@pytest.mark.realtime
def test_a_lease_that_was_lost_is_not_taken_again_by_itself(daemons: Any, tmp_path: Path) -> None:
    lost = {"error": "io.twind.Control.Refused", "parameters": {"findings": []}}
    daemon = daemons("control", lambda method: lost if method == "RenewLease" else {"parameters": {}})
    holders: queue.Queue[int | None] = queue.Queue()
    operator, outcomes = Operator(str(tmp_path), holders.put), queue.Queue()
    operator.take(1, outcomes.put)
    assert [holders.get(timeout=5.0), holders.get(timeout=5.0)] == [1, None]
    assert daemon.asked == ["AcquireLease", "RenewLease"]


@pytest.mark.realtime
def test_what_was_done_is_said_also_where_the_lease_is_gone_afterwards(daemons: Any, tmp_path: Path) -> None:
    armed = threading.Event()
    other = {"error": "io.twind.Control.LeaseHeld", "parameters": {"lease": LEASE}}

    def answers(method: str) -> Any:
        if method == "Arm":
            armed.set()
        taken = armed.is_set() and method == "AcquireLease"
        return other if taken else {"parameters": {"joints": []}}

    daemons("control", answers)
    holders: queue.Queue[int | None] = queue.Queue()
    operator, outcomes = Operator(str(tmp_path), holders.put), queue.Queue()
    operator.take(1, outcomes.put)
    assert told(outcomes).done
    operator.call(1, arm, outcomes.put)
    outcome = told(outcomes)
    assert (outcome.done, outcome.title) == (True, "armed")
    assert "the lease is gone: the lease is held by uid 0" in outcome.text
    assert [holders.get(timeout=5.0), holders.get(timeout=5.0)] == [1, None]


@pytest.mark.realtime
def test_rubbish_for_an_answer_costs_the_operator_one_call_and_no_more(daemons: Any, tmp_path: Path) -> None:
    daemons("control", lambda method: {"parameters": {}})  # Arm says no joints
    operator, outcomes = Operator(str(tmp_path), lambda tab: None), queue.Queue()
    operator.take(1, outcomes.put)
    assert told(outcomes).done
    operator.call(1, arm, outcomes.put)
    assert told(outcomes).title == "NOT confirmed"
    operator.give(1, outcomes.put)
    assert told(outcomes).title == "lease given back"


@pytest.mark.realtime
def test_a_page_that_cannot_be_asked_loses_the_lease(daemons: Any, tmp_path: Path) -> None:
    daemon = daemons("control", lambda method: {"parameters": {}})
    operator, outcomes = Operator(str(tmp_path), lambda tab: None), queue.Queue()
    operator.take(1, outcomes.put)
    assert told(outcomes).done
    look_after(operator, 1, lambda: {}["no such page"])
    assert daemon.ended.get(timeout=5.0) == "closed"


# ---------------------------------------------------------------------------------------- messages


@pytest.mark.realtime
def test_messages_go_on_after_one_that_is_none(daemons: Any, tmp_path: Path) -> None:
    answers: dict[str, Any] = {"GetRobot": {"parameters": h24()}, "Monitor": {"parameters": {"no": "topic"}}}
    daemons("observe", answers.get)
    ended = threading.Event()
    news = messages(str(tmp_path), ended)
    found = [next(news) for _ in range(4)]
    assert isinstance(found[0], Described) and isinstance(found[3], Described)
    assert isinstance(found[2], Lost) and "KeyError" in found[2].why
    ended.set()


def test_a_message_that_is_none_is_said_and_the_next_one_is_shown() -> None:
    known, robot = Known(), h24()
    seen: list[tuple[str | None, bool]] = []

    def news() -> Iterator[News]:
        for each in (Described(robot), {"topic": "state"}, state(robot, 1.0)):
            yield each
            seen.append((known.now().lost, known.now().joints is not None))
        raise OSError("the file is gone")

    viewer.take(known, news())
    assert seen[0] == (None, False)
    assert "KeyError" in str(seen[1][0]) and not seen[1][1]
    assert seen[2] == (None, True)
    assert known.now().lost == "the messages have ended: OSError: the file is gone"


def test_the_age_of_what_is_seen_is_said_and_red_from_a_second_on() -> None:
    clock = FakeClock()
    known, robot = Known(clock.now), h24()
    assert "s ago" not in words.page(known.now(), None, None, 0)
    known.take(state(robot))
    clock.time = 0.9
    assert "less than 1 s ago" in words.page(known.now(), None, None, 0)
    clock.time = 12.0
    said = words.page(known.now(), None, None, 0)
    assert words.row("heard", "12 s ago: the picture is old", words.RED) in said
    known.take(status())  # says nothing of joints
    assert "12 s ago" in words.page(known.now(), None, None, 0)


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
    daemons: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    monkeypatch.setattr(viewer, "Scene", lambda *_: SimpleNamespace(remove=lambda: None))
    monkeypatch.setattr(viewer, broken, lambda told: {}["no such pose"])
    daemons("control", lambda method: {"parameters": {"state": "estop"}})
    stops, outcomes, known, canvas = Stops(str(tmp_path)), queue.Queue(), Known(), Canvas()
    for news in (Described(h24()), status(), state(h24())):
        known.take(news)
    ended = threading.Event()
    shown = viewer.Viewer(Site(canvas, ""), known, canvas)
    drawing = threading.Thread(target=viewer.run, args=(shown, known, (), ended))
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
def test_messages_go_on_when_a_daemon_comes_back(daemons: Any, tmp_path: Path) -> None:
    ended = threading.Event()
    news = messages(str(tmp_path), ended)
    assert isinstance(next(news), Lost)
    answers = {"GetRobot": {"parameters": h24()}, "Monitor": {"parameters": status()}}
    daemons("observe", answers.get)
    found: list[News] = [next(news), next(news), next(news)]
    assert isinstance(found[0], Described)
    assert isinstance(found[2], Described)  # the stream ended, and it asked anew
    ended.set()


def test_what_is_known_is_the_latest_and_no_older_than_its_window() -> None:
    known, robot = Known(), h24()
    known.take(Described(robot))
    for step in range(40):
        known.take(state(robot, 0.5 * step, head_yaw=0.01 * step))
    path = known.path()
    assert path[-1].measured[0] == pytest.approx(0.39)
    assert path[-1].time - path[0].time <= WINDOW
    known.take(state(robot, 0.0))  # a recording that began anew
    assert [each.time for each in known.path()] == [0.0]
    known.take(Described(other()))
    assert known.now().joints is None and known.path() == []


def test_only_refusals_warnings_and_errors_are_kept() -> None:
    known = Known()
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
    known, robot = Known(), h24()
    silent = {"heard": False, "age_ms": 900.0}
    known.take(state(robot, head_yaw={"age_ms": 90.0}, head_pitch={"age_ms": None}, l_elbow=silent))
    now = known.now()
    assert now.joints is not None
    old = [joint["name"] for joint, each in zip(robot["robot"]["joints"], now.stale, strict=True) if each]
    assert old == ["head_yaw", "head_pitch"]  # who is not heard at all is marked as that


# ---------------------------------------------------------------------------------------- what is drawn


def test_every_joint_turns_its_own_body_of_the_model() -> None:
    robot = h24()
    likeness = Likeness(robot)
    still = likeness.places(likeness.rest)
    for place, name in enumerate(likeness.joints):
        pose = likeness.rest.copy()
        pose[place] += 0.3
        moved = likeness.places(pose).differ(still, 1e-6, 1e-3)
        assert moved[likeness.bodies_of[place]], name
        assert not moved[likeness.model.body("torso").id]


def test_a_joint_that_is_not_known_is_drawn_at_rest() -> None:
    likeness = Likeness(h24())
    unknown = likeness.places(np.full(len(likeness.rest), np.nan))
    assert not unknown.differ(likeness.places(likeness.rest), 1e-9, 1e-6).any()


def test_the_nearest_pair_is_told_with_its_bounds_and_its_points() -> None:
    likeness = Likeness(h24())
    near, touching = likeness.nearest(likeness.rest)
    assert near is not None and near.level == "clear" and len(touching) == 0
    assert np.linalg.norm(near.ends[1] - near.ends[0]) == pytest.approx(near.distance, abs=1e-3)
    pose = likeness.rest.copy()
    pose[likeness.joints.index("l_shoulder_roll")] = -0.14  # into the hip
    close, _ = likeness.nearest(pose)
    assert close is not None and close.distance < near.distance
    assert (close.block, close.warn) == (0.002, 0.01)


def test_bodies_that_have_shapes_in_group_three_alone_are_drawn_with_them() -> None:
    model = Likeness(other()).model
    assert shown_geoms(model, model.body("trunk").id) == [1]
    both = GROUP_THREE.replace(
        '<geom type="box"', '<geom type="sphere" size="0.1" mass="1" group="1"/><geom type="box"'
    )
    model = Likeness(other(both)).model
    assert [int(model.geom_group[g]) for g in shown_geoms(model, model.body("trunk").id)] == [1]


def test_meshes_that_cannot_be_read_have_a_stand_in_and_it_is_said() -> None:
    mesh = '<asset><mesh name="m" file="gone.stl"/></asset><worldbody>'
    mjcf = GROUP_THREE.replace("<worldbody>", mesh).replace(
        '<geom type="capsule" fromto="0 0.03 0 0 0.03 -0.25" size="0.03" group="3" mass="0.2"/>',
        '<geom type="mesh" mesh="m" mass="0.2"/>',
    )
    likeness = Likeness(other(mjcf))
    assert likeness.meshes_missing
    known = Known()
    known.take(status())
    assert "balls stand for them" in words.page(known.now(), likeness, None, 0)


def test_a_model_that_is_none_is_told() -> None:
    with pytest.raises(NoLikeness, match="cannot be compiled"):
        Likeness(other("<mujoco><nonsense/></mujoco>"))
    with pytest.raises(NoLikeness, match="nowhere"):
        Likeness(other(joints=("nowhere",)))


@pytest.mark.parametrize(
    ("choice", "mode", "shown"),
    [
        (AUTO, "live", (True, False)),
        (AUTO, "sim", (True, False)),
        (AUTO, "mirror", (False, True)),
        (BOTH, "live", (True, True)),
        (NONE, "mirror", (False, False)),
        ("simulation", "live", (False, True)),
    ],
)
def test_the_translucent_figure_is_what_takes_commands(
    choice: str, mode: str, shown: tuple[bool, bool]
) -> None:
    assert ghosts(choice, mode) == shown


# ---------------------------------------------------------------------------------------- words and plots


def test_no_word_of_anybody_becomes_markup() -> None:
    evil = "<img src=x onerror=alert(1)>"
    known = Known()
    finding = {"code": evil, "message": evil}
    known.take(
        status(robot=evil, lease={"holder": evil, "uid": 0, "expires_in": 1.0}, faults=[finding], state=evil)
    )
    known.take({"topic": "events", "time": 0.0, "event": {"level": "error", "code": evil, "message": evil}})
    known.take({"topic": "verdicts", "time": 0.0, "verdict": {"refusals": [finding]}})
    assert "<img" not in words.page(known.now(), None, None, 0)
    known.take(Lost(evil))
    assert "<img" not in words.page(known.now(), None, None, 0)


def test_the_tracking_error_is_that_of_joints_that_have_a_goal() -> None:
    known, robot = Known(), h24()
    known.take(state(robot, 1.0))
    assert np.isnan(plots.tracking(known)[1]).all() and plots.worst(known) is None
    known.take(state(robot, 2.0, l_knee={"position": 0.1, "goal": 0.15}, r_knee={"goal": 0.01}))
    time, most, rms = plots.tracking(known)
    assert time.tolist() == [-1.0, 0.0]
    assert most[-1] == pytest.approx(50.0)
    assert rms[-1] == pytest.approx(np.sqrt((50.0**2 + 10.0**2) / 2.0))
    names = [joint["name"] for joint in robot["robot"]["joints"]]
    worst = plots.worst(known)
    assert worst is not None and names[worst] == "l_knee"
    assert plots.joint(known, worst)[2][-1] == pytest.approx(0.1)


def test_in_mirror_the_tracking_error_is_that_of_the_simulation() -> None:
    known, robot = Known(), h24()
    held = {"position": 0.5, "goal": 0.1, "simulated": 0.09}
    for time, mode in enumerate(("live", "mirror", "sim")):
        known.take(status(mode=mode))
        known.take(state(robot, float(time), l_knee=held))
    assert plots.tracking(known)[1] == pytest.approx([400.0, 10.0, 10.0])


@pytest.mark.parametrize("place", [37, 700, 1999])
def test_a_peak_of_one_sample_is_in_the_plots(place: int) -> None:
    known, robot = Known(), h24()
    for step in range(2000):
        off = 0.3 if step == place else 0.0
        known.take(state(robot, 0.005 * step, l_knee={"position": off, "goal": 0.0}))
    time, most, _ = plots.tracking(known)
    assert most.max() == pytest.approx(300.0)
    knee = [joint["name"] for joint in robot["robot"]["joints"]].index("l_knee")
    lines = plots.joint(known, knee)
    assert lines[2].max() == pytest.approx(0.3) and lines[0][lines[2].argmax()] == pytest.approx(
        0.005 * (place - 1999)
    )
    assert max(time.size, lines[0].size) <= 2 * plots.POINTS and (np.diff(lines[0]) > 0.0).all()


def test_latency_is_plotted_by_hop() -> None:
    known = Known()
    hops = [{"hop": "total", "now_ms": 3.0}, {"hop": "twin", "now_ms": None}]
    known.take({"topic": "latency", "time": 1.0, "latency": hops})
    time, total, twin, *_ = plots.latency(known)
    assert (time.tolist(), total.tolist()) == ([0.0], [3.0])
    assert np.isnan(twin).all()


# ---------------------------------------------------------------------------------------- without the extra


def test_without_its_libraries_the_viewer_says_what_to_install(monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setattr(view, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"pip install 'twind\[view\]'"):
        view.run(Namespace())
    monkeypatch.setattr(demo_viewer, "find_spec", lambda name: None)
    with demo_viewer.viewer("nowhere", lambda: None):
        said = capsys.readouterr().out
    assert said.count("\n") == 1 and "pip install 'twind[view]'" in said


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=40))
def test_what_is_known_lies_inside_its_axis_whatever_is_not(values: list[float]) -> None:
    least, most = plots.extent((np.array([np.nan, *values]),))
    assert least < most and all(least <= value <= most for value in values)
    assert plots.extent((np.array([np.nan]),)) == (0.0, 1.0)
