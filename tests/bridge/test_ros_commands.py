"""Commands from ROS: each is done, or its sender gets the reason; a stop whatever its bytes are."""

import json
import time
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import pytest

from tests.support.processes import until
from tests.support.ros_trajectory_messages import NOW, command, point
from tests.support.scripted_line import ScriptedDaemon, ended
from twind.bridge.commands.stop_queues import Outcome
from twind.bridge.ros import ros_commands
from twind.bridge.ros.ros_commands import (
    MODE_PACE,
    MORE,
    PACE,
    PATIENT,
    ROOM,
    STOP_PACE,
    STOPPING,
    RosCommands,
)
from twind.bridge.ros.ros_endpoints import (
    E_STOP,
    GET_STATUS,
    SERVICES,
    SET_LIVE,
    SET_MODE,
    STOP,
    TO_E_STOP,
    TO_MODE,
    TO_STOP,
    TRAJECTORY,
    RosTopic,
)
from twind.bridge.ros.ros_trajectory import LONGEST
from twind.bridge.ros.ros_transport import answer_to
from twind.ros import STRING, encode

FAR: Any = (
    "Refused",
    {"findings": [{"code": "POS_LIMIT", "message": "l_knee"}, {"code": "VEL_LIMIT", "message": "head"}]},
)
HELD: Any = ("LeaseHeld", {"lease": {"holder": "uid 7, pid 8", "uid": 7, "expires_in": 0.5}})
READ_ONLY: Any = ("NotAllowed", {"role": "observer", "method": "AcquireLease"})
GOOD = command(point(1.0), frame="mine", when=NOW)


def text(words: str) -> bytes:
    return encode(STRING, {"data": words})


def status_text(outcome: Outcome) -> str:
    return json.dumps(outcome) if isinstance(outcome, Mapping) else str(outcome)


class Desk:
    """Commands and the daemon that they go to. `closed`: why no hold (True), no other command is taken."""

    def __init__(self) -> None:
        self.offset = 0.0  # s that the test moved the clock of trajectories
        self.stands = 0.0  # s, where that clock stands still: a busy machine lets no command expire
        self.daemon = ScriptedDaemon()
        self.results: list[dict[str, Any]] = []
        self.closed: dict[bool, str] = {}
        self.lines: list[str] = []
        self.commands = RosCommands(
            self.daemon.client,
            self.daemon.client,
            status=status_text,
            closed=lambda stop: self.closed.get(stop, ""),
            on_result=lambda result: self.results.append(dict(result)),
            tell=self.lines.append,
            wall_ns=lambda: NOW,
            now=lambda: (self.stands or time.monotonic()) + self.offset,
        )

    def receive(self, topic: RosTopic, data: bytes, phase: str = "") -> dict[str, Any]:
        """Send a message; return its first result, or that with `phase`."""
        before = len(self.results)
        self.commands.on_message(topic, data)
        return self.result(before, phase)

    def result(self, before: int, phase: str = "") -> dict[str, Any]:
        def found() -> list[dict[str, Any]]:
            return [each for each in self.results[before:] if each["phase"] == phase or not phase]

        until(found, 10.0, lambda: f"{phase}: {self.results} {self.lines}")
        return found()[0]


@pytest.fixture
def desk() -> Iterator[Desk]:
    made = Desk()
    made.commands.start()
    yield made
    made.commands.stop(5.0)
    assert made.daemon.open == 0


@pytest.fixture
def still() -> Desk:
    """A desk whose queues serve nothing until they are started, at one time."""
    made = Desk()
    made.stands = time.monotonic()
    return made


# ---------------------------------------------------------------------------------------------- trajectories


def test_an_accepted_command_is_reported_to_its_end_with_its_own_stamp(desk: Desk) -> None:
    desk.receive(TRAJECTORY, GOOD, "accepted")
    desk.commands.motions.on_monitor_reply(ended("m1", "succeeded"))
    desk.result(0, "succeeded")
    for told in desk.results:
        assert told["topic"] == "/cmd/joint_trajectory" and told["frame_id"] == "mine" and told["id"] == "m1"
        assert told["stamp"] == {"sec": NOW // 10**9, "nanosec": NOW % 10**9}
    (asked,) = desk.daemon.named("SubmitTrajectory")
    assert asked["trajectory"]["points"] == [{"positions": [0.5], "time_from_start": 1.0}]


@pytest.mark.parametrize(
    ("data", "refuse", "message"),
    [
        (command(point(1.0, [float("nan")])), {}, "positions is nan"),
        (b"\0\1\0\0", {}, "malformed"),
        (bytes(5 * LONGEST), {}, "2097152 bytes"),
        (GOOD, {"SubmitTrajectory": FAR}, "POS_LIMIT: l_knee; VEL_LIMIT: head"),
        (GOOD, {"AcquireLease": HELD}, "held by uid 7, pid 8, which keeps it"),
        (GOOD, {"AcquireLease": READ_ONLY}, "control.sock"),
    ],
)
def test_a_refused_command_is_reported_with_the_reason_in_one_line(
    desk: Desk, data: bytes, refuse: dict[str, Any], message: str
) -> None:
    desk.daemon.refuse = refuse
    told = desk.receive(TRAJECTORY, data)
    assert told["phase"] == "refused" and message in told["message"] and told["message"].isprintable()


def test_a_command_that_waited_too_long_expires(still: Desk) -> None:
    still.commands.on_message(TRAJECTORY, GOOD)
    still.offset = PATIENT + 0.1
    still.commands.start()
    assert still.result(0)["findings"][0]["code"] == "CMD_EXPIRED"


def test_a_closed_bridge_refuses_a_trajectory_with_the_reason(desk: Desk) -> None:
    desk.closed = {False: "another bridge"}
    assert desk.receive(TRAJECTORY, GOOD)["message"] == "another bridge"
    assert not desk.daemon.calls


def for_joints(desk: Desk, *joints: str, when: int = 0, frame: str = "") -> None:
    data = command(point(1.0), joints=joints, when=when, frame=frame or ",".join(joints))
    desk.commands.on_message(TRAJECTORY, data)


def test_a_newer_command_drops_those_of_which_it_leaves_nothing(still: Desk) -> None:
    for_joints(still, "a")
    for_joints(still, "b")
    for_joints(still, "later", when=NOW + 10**9)
    goals: list[str] = []
    still.commands.goal(command(point(1.0), joints=("a",)), lambda result: goals.append(result["phase"]))
    still.commands.on_message(TRAJECTORY, b"malformed")
    for_joints(still, "a", "c")
    for_joints(still, "later", frame="sooner")
    still.commands.start()
    until(lambda: len(still.results) == 7, 10.0, lambda: f"{still.results}")
    phases = {each["frame_id"]: each["phase"] for each in still.results}
    assert phases["a"] == "dropped" and {phases[each] for each in ("b", "a,c", "later")} == {"accepted"}
    assert goals[0] == phases["sooner"] == "accepted"


def test_a_newer_command_that_is_refused_drops_nothing(still: Desk) -> None:
    for_joints(still, "a")
    nothing = command(point(1.0, [float("nan")]), joints=("a",), frame="newer")
    still.commands.on_message(TRAJECTORY, nothing)
    still.commands.start()
    until(lambda: len(still.results) == 2, 10.0, lambda: f"{still.results}")
    assert [(each["frame_id"], each["phase"]) for each in still.results] == [
        ("newer", "refused"),
        ("a", "accepted"),
    ]


def test_a_flood_reaches_the_daemon_at_a_bounded_rate_and_each_command_is_accounted_for(desk: Desk) -> None:
    begun = time.monotonic()
    for number in range(600):
        joint = f"joint_{number % 20}"
        desk.commands.on_message(TRAJECTORY, command(point(1.0), joints=(joint,)))
        time.sleep(0.001)
    until(lambda: sum(each.get("count", 1) for each in desk.results) == 600, 10.0, "all reports")
    took = time.monotonic() - begun
    assert 1 <= len(desk.daemon.named("SubmitTrajectory")) <= 1 + took / PACE
    assert len([each for each in desk.results if each["phase"] == "dropped"]) <= 2 + took


def test_a_goal_is_followed_to_its_end_with_its_tolerances_and_cancelled(desk: Desk) -> None:
    phases: list[str] = []
    tolerances = [{"joint": "l_knee", "goal": 0.1}]
    goal = desk.commands.goal
    cancel = goal(GOOD, lambda result: phases.append(result["phase"]), goal_time=2.0, tolerances=tolerances)
    until(lambda: "running" in phases, 10.0, "it runs")
    cancel()
    until(lambda: desk.daemon.named("Cancel"), 10.0, "the cancel")
    desk.commands.motions.on_monitor_reply(ended("m1", "cancelled"))
    until(lambda: phases[-1] == "cancelled", 10.0, "its end")
    assert phases[0] == "accepted" and set(phases[1:-1]) == {"running"}
    (asked,) = desk.daemon.named("SubmitTrajectory")
    assert asked["trajectory"]["goal_time"] == 2.0 and asked["trajectory"]["tolerances"] == tolerances
    assert [each["phase"] for each in desk.results] == ["accepted", "cancelled"]


def test_a_goal_that_finds_no_room_and_one_with_long_tolerances_are_refused(still: Desk) -> None:
    reports = [list[dict[str, Any]]() for _ in range(ROOM + 1)]
    tolerances = [{"joint": "x" * MORE}]
    for each in reports:
        still.commands.goal(GOOD, lambda result, each=each: each.append(dict(result)), tolerances=tolerances)
    assert [len(each) for each in reports] == [1] + [0] * ROOM
    assert "wait: send it again" in reports[0][0]["message"]
    still.commands.start()
    until(lambda: reports[1], 10.0, "a report")
    assert "tolerances of" in reports[1][0]["message"] and not still.daemon.calls


def test_a_defect_is_reported_to_the_sender(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_commands, "trajectory", lambda data, now: [][1])
    assert "IndexError" in desk.receive(TRAJECTORY, GOOD)["message"]


def test_a_stop_voids_the_commands_that_wait(still: Desk) -> None:
    still.commands.on_message(TRAJECTORY, GOOD)
    still.commands.on_message(STOP, b"")
    for queue in still.commands.stops.queues.values():
        queue.start()
    still.result(0, "done")
    still.commands.trajectories.start()
    assert still.result(1)["findings"][0]["code"] == "BUSY" and not still.daemon.named("SubmitTrajectory")
    still.commands.stop(5.0)


# --------------------------------------------------------------------------------------------- stops, modes


@pytest.mark.parametrize(
    ("data", "level"),
    [
        (text(""), "settle"),
        (text("cut"), "cut"),
        (text("SETTLE please"), "settle"),
        (b"", "settle"),
        (b"\0\1\0\0\xff\xff\xff\xff", "settle"),
    ],
)
def test_any_e_stop_message_triggers_an_e_stop(desk: Desk, data: bytes, level: str) -> None:
    desk.closed = {True: "it only looks", False: "it only looks"}
    told = desk.receive(E_STOP, data)
    assert (told["phase"], told["asked"]) == ("done", level)
    (asked,) = desk.daemon.named("EStop")
    assert asked["level"] == level and asked["reason"] == "requested over ROS"


@pytest.mark.parametrize("data", [text(""), text("now"), b"\0"])
def test_any_stop_message_triggers_a_stop(desk: Desk, data: bytes) -> None:
    result = desk.receive(STOP, data)
    assert (result["phase"], result["message"]) == ("done", STOPPING)  # the motion's state, not the bus's
    assert desk.daemon.named("Cancel") == [{}]


def test_a_valid_mode_is_requested_and_an_unknown_mode_is_reported(desk: Desk) -> None:
    told = desk.receive(SET_MODE, text("mirror"))
    topic = "/bridge/set_mode_cmd"
    assert told == {"topic": topic, "asked": "mirror", "phase": "done", "message": "mirror"}
    known = {"what": "mode", "name": "warp", "known": ["sim", "mirror", "live"]}
    desk.daemon.refuse["SetMode"] = ("NotFound", known)
    assert "known: sim, mirror, live" in desk.receive(SET_MODE, text("warp"))["message"]
    assert desk.receive(SET_MODE, b"\0\1\0\0")["message"].startswith("malformed")
    assert len(desk.daemon.named("SetMode")) == 2


@pytest.mark.parametrize(
    ("topic", "texts", "pace"),
    [(SET_MODE, (text("sim"), b"\0", text("live")), MODE_PACE), (STOP, (b"",), STOP_PACE)],
)
def test_a_flood_has_a_call_and_a_result_now_and_then_and_ends_with_the_last(
    desk: Desk, topic: RosTopic, texts: tuple[bytes, ...], pace: float
) -> None:
    begun = time.monotonic()
    while time.monotonic() < begun + 0.5:
        for each in texts:
            desk.commands.on_message(topic, each)
        time.sleep(0.001)
    most = 1 + (time.monotonic() - begun) / pace
    assert 0 < len(desk.results) <= most and len(desk.daemon.calls) <= most
    if topic is SET_MODE:
        until(lambda: {"mode": "live"} in desk.daemon.named("SetMode"), 10.0, "the last")


def test_every_service_is_answered(desk: Desk) -> None:
    answer = desk.daemon.answer
    status = b'{"parameters": {"status": {"mode": "sim"}}}'
    desk.daemon.answer = lambda message: status if b"GetStatus" in message else answer(message)  # type: ignore[method-assign]
    ask = partial(answer_to, desk.commands.on_request)
    assert {GET_STATUS, TO_STOP, TO_E_STOP, SET_LIVE, *TO_MODE.values()} == set(SERVICES)
    assert ask(GET_STATUS, None) == (True, '{"status": {"mode": "sim"}}')
    assert ask(TO_STOP, None) == (True, STOPPING) and ask(TO_E_STOP, None) == (True, "estop")
    assert ask(TO_MODE["mirror"], None) == (True, "mirror")
    assert ask(SET_LIVE, True) == (True, "live") and ask(SET_LIVE, False) == (True, "mirror")


def test_a_service_that_is_closed_or_fails_replies_with_the_reason(desk: Desk) -> None:
    desk.closed = {True: "it only looks", False: "another bridge"}
    assert answer_to(desk.commands.on_request, TO_STOP, None) == (False, "it only looks")
    assert answer_to(desk.commands.on_request, SET_LIVE, True) == (False, "another bridge")
    assert not desk.daemon.calls
    desk.closed = {}
    desk.daemon.absent = True
    assert answer_to(desk.commands.on_request, TO_STOP, None) == (False, "nobody listens")
    assert answer_to(desk.commands.on_request, GET_STATUS, None) == (True, "nobody listens")
