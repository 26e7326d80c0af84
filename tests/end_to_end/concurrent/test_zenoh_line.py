"""A robot from afar as a client sees it: real Zenoh on loopback, faults ordered at the robot's end."""

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from typing import Any

import pytest
import zenoh

from tests.support.processes import until
from tests.support.remote_robot import CLOCK, FarRobot
from tests.support.zenoh_router import Router
from twind.bridge.fleet import repeated_queries
from twind.bridge.fleet.client_sessions import PrivateSession, SharedSession
from twind.bridge.fleet.remote_client import client
from twind.bridge.fleet.repeated_queries import RENEWED, REPORTS
from twind.bridge.zenoh.zenoh_keys import LEASE_S
from twind.bridge.zenoh.zenoh_session import NetworkConfig, open_now
from twind.client import CallError, Disconnected, NoAnswer, NoDaemon, NotCarried, Refused
from twind.client.errors import as_error
from twind.command_line.verb import UsageError, lease

PATH = {"joint_names": ["knee"], "points": [{"positions": [0.5], "time_from_start": 1.0}]}
CONTROL = "io.twind.Control"


@pytest.fixture
def robot() -> Iterator[FarRobot]:
    with FarRobot() as made:
        yield made


class GoalAnswers:
    """Answers of a robot to a goal: accepted, then the state that a test sets."""

    def __init__(self) -> None:
        self.state: dict[str, Any] = {"id": "7", "phase": "running", "progress": 0.1}

    def __call__(self, asked: dict[str, Any]) -> dict[str, Any]:
        if "trajectory" in asked:
            return {"id": "7", "phase": "accepted", "progress": 0.0, "verdict": {"refusals": []}}
        return self.state

    def set(self, phase: str, progress: float) -> None:
        self.state = {"id": "7", "phase": phase, "progress": progress}


def test_a_question_is_asked_and_its_answer_and_its_error_come_as_beside_the_robot(robot: FarRobot) -> None:
    def refuse(_asked: dict[str, Any]) -> None:
        raise as_error(f"{CONTROL}.Refused", {"findings": [{"code": "POS_LIMIT", "message": "knee"}]})

    robot.answers |= {"ask/GetStatus": lambda asked: {"asked": asked}, "check": refuse}
    with robot.client() as client:
        assert client.call("GetStatus", joints=True) == {"asked": {"joints": True}}
        with pytest.raises(Refused, match="POS_LIMIT: knee"):
            client.call("Check", trajectory=PATH)
        assert client.call("GetStatus") == {"asked": {}}


@pytest.mark.parametrize("method", ["Arm", "Disarm", "SetMode", "WriteRegister", "Setpoint", "Reset", "Mark"])
def test_a_method_reserved_for_local_clients_is_never_sent(robot: FarRobot, method: str) -> None:
    with robot.client() as client, pytest.raises(NotCarried, match=f"{method}: not for remote clients"):
        client.call(method)
    assert robot.asked == []


def test_a_goal_needs_a_lease_and_a_topic_that_is_sent(robot: FarRobot) -> None:
    with robot.client() as client:
        with pytest.raises(NotCarried, match="under a lease"):
            client.stream("SubmitTrajectory", trajectory=PATH)
        with pytest.raises(NotCarried, match="'raw': not from afar"):
            client.stream("Monitor", topics=["raw"])
    assert robot.asked == []


def test_an_absent_robot_an_absent_network_and_an_invalid_name_raise_different_errors(
    robot: FarRobot,
) -> None:
    robot.alive.undeclare()
    with pytest.raises(NoDaemon, match=r"robot r1 by tcp/.*: not present; `twindctl fleet` lists the robots"):
        robot.client(timeout=0.6).call("GetStatus")
    robot.close()
    with pytest.raises(NoDaemon, match="--remote ROBOT@tcp/HOST:PORT"):
        robot.client(timeout=0.6).call("GetStatus")
    robot.name = "a/b"
    with pytest.raises(UsageError, match="'a/b'"):
        robot.client()


def test_an_uplink_without_a_daemon_a_question_without_an_answer_and_a_robot_that_goes_away(
    robot: FarRobot,
) -> None:
    def no_daemon(_asked: dict[str, Any]) -> None:
        raise CallError("io.twind.Uplink.NoDaemon", {"message": "no such socket"})

    robot.answers |= {"ask/GetStatus": no_daemon, "ask/GetRobot": lambda _: None, "check": lambda _: None}
    with robot.client() as client:
        with pytest.raises(NoDaemon, match="its uplink is there, its daemon is not: no such socket"):
            client.call("GetStatus")
        with pytest.raises(Disconnected, match="no answer to ask/GetRobot"):
            client.call("GetRobot")
        robot.slow = 3.0
        client.timeout = 0.2
        with pytest.raises((NoAnswer, Disconnected)):
            client.call("Check", trajectory=PATH)
        client.timeout = 20.0
        events = client.stream("Monitor", topics=["events"])
        threading.Timer(0.3, robot.close).start()
        with pytest.raises(Disconnected, match="it went away"):
            list(events)


def test_a_stop_is_sent_to_an_invisible_robot_until_a_reply_arrives(
    robot: FarRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(repeated_queries, "LASTING", 1.0)
    robot.alive.undeclare()
    unheard = [None, None]
    robot.answers["stop/EStop"] = lambda asked: unheard.pop() if unheard else {"state": "estop", **asked}
    with robot.client() as client:
        assert client.call("EStop", level="settle") == {"state": "estop", "level": "settle"}
        robot.answers["stop/Cancel"] = lambda _: None
        with pytest.raises(Disconnected, match="no answer to stop/Cancel"):
            client.call("Cancel")
    assert len(robot.times("stop/EStop")) == 3 and len(robot.times("stop/Cancel")) > 3


def refuse_with(name: str, **parameters: Any) -> None:
    raise as_error(name, parameters)


def test_a_stop_that_is_answered_by_an_error_is_asked_again_until_it_is_done(
    robot: FarRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flood of others makes a robot too busy for a moment; a stop is not given up for that."""
    monkeypatch.setattr(repeated_queries, "LASTING", 1.0)
    errors = [f"{CONTROL}.Busy", "io.twind.Uplink.Failed", "io.twind.Uplink.NoDaemon"]

    def estop(asked: dict[str, Any]) -> dict[str, Any]:
        if errors:
            refuse_with(errors.pop(), what="too much is asked", message="no such socket")
        return {"state": "estop", **asked}

    robot.answers["stop/EStop"] = estop
    with robot.client() as client:
        assert client.call("EStop", level="cut") == {"state": "estop", "level": "cut"}
        assert len(robot.times("stop/EStop")) == 4
        robot.answers["stop/EStop"] = lambda _: refuse_with(f"{CONTROL}.Busy", what="always")
        with pytest.raises(CallError, match="always"):
            client.call("EStop", level="cut")
    assert len(robot.times("stop/EStop")) > 4 + 3


@pytest.mark.parametrize("error", [f"{CONTROL}.NotAllowed", "org.varlink.service.InvalidParameter"])
def test_a_stop_that_will_never_be_done_is_asked_once(robot: FarRobot, error: str) -> None:
    robot.answers["stop/Cancel"] = lambda _: refuse_with(error)
    with robot.client() as client, pytest.raises(CallError):
        client.call("Cancel")
    assert len(robot.times("stop/Cancel")) == 1


def test_an_impostor_that_answers_for_a_robot_does_not_intercept_a_stop() -> None:
    with Router() as router, ExitStack() as stack:
        place = NetworkConfig(connect=(router.endpoint,))
        true, false = (stack.enter_context(open_now(place, 5.0)) for _ in range(2))
        heard = threading.Event()

        def stopped(query: zenoh.Query) -> None:
            heard.set()
            query.reply("twind/r1/stop/EStop", b'{"state": "estop"}')

        def lied(query: zenoh.Query) -> None:
            query.reply_err(b'{"error": "io.twind.Control.Busy", "parameters": {}}')

        # Who says that his answer is complete is asked alone, as the one who is nearest.
        false.declare_queryable("twind/r1/stop/EStop", lied, complete=True)
        true.declare_queryable("twind/r1/stop/EStop", stopped)
        time.sleep(0.5)  # both are known everywhere
        with client("r1", PrivateSession(place)) as asking:
            assert asking.call("EStop", level="cut") == {"state": "estop"}
        assert heard.is_set()


def test_a_lease_that_another_has_is_taken_by_the_robots_clock_and_asked_for_first(robot: FarRobot) -> None:
    def grant(asked: dict[str, Any]) -> dict[str, Any]:
        if asked["op"] == "acquire" and not asked.get("take"):
            lease = {"holder": "bob", "uid": 0, "expires_in": 1.0}
            refuse_with(f"{CONTROL}.LeaseHeld", lease=lease, now=1000.0)
        return robot.grant(asked)

    robot.answers["lease"] = grant
    with robot.client() as client:
        with pytest.raises(CallError, match="bob"):
            client.call("AcquireLease")
        client.call("AcquireLease", take=True)
    first, second, third, release = robot.times("lease")
    assert "take" not in first and "take" not in second and release["op"] == "release"
    assert (third["take"], third["deadline"]) == (True, 1000.0 + LEASE_S)


def test_a_failed_renewal_is_repeated_until_the_lease_is_reported_missing(
    robot: FarRobot,
) -> None:
    missing = {"findings": [{"code": "LEASE_MISSING", "message": "not held"}]}
    answers = [(f"{CONTROL}.Busy", {"what": "much"}), (f"{CONTROL}.Refused", missing)]

    def answer(asked: dict[str, Any]) -> dict[str, Any]:
        if asked["op"] == "renew" and answers:
            name, parameters = answers.pop(0)
            refuse_with(name, **parameters)
        return robot.grant(asked)

    goal = GoalAnswers()
    robot.answers |= {"lease": answer, "goal": goal}
    with robot.client() as client:
        client.call("AcquireLease")
        reports = client.stream("SubmitTrajectory", trajectory=PATH)
        threading.Timer(6.0 * RENEWED, lambda: goal.set("aborted", 0.5)).start()
        assert list(reports)[-1]["phase"] == "aborted"
    assert [each["op"] for each in robot.times("lease")] == ["acquire", "renew", "renew"]


def test_while_a_goal_is_judged_it_is_not_sent_again(robot: FarRobot) -> None:
    goal = GoalAnswers()

    def slowly(asked: dict[str, Any]) -> dict[str, Any]:
        if "trajectory" in asked:
            time.sleep(4.0 * REPORTS)
        return goal(asked)

    robot.answers["goal"] = slowly
    with robot.client() as client, lease(client):
        reports = client.stream("SubmitTrajectory", trajectory=PATH)
        next(reports)
        assert len(robot.times("goal")) == 1
        goal.set("succeeded", 1.0)
        assert list(reports)[-1]["phase"] == "succeeded"


def test_news_are_the_bytes_that_the_robot_sent_and_only_of_what_was_asked(robot: FarRobot) -> None:
    with robot.client() as client:
        stream = client.stream("Monitor", topics=["state", "events"], rate=30.0)
        time.sleep(0.3)  # a subscription travels
        for number in range(3):
            robot.tell("state/30", {"parameters": {"topic": "state", "n": number}, "continues": True})
        robot.tell("state/full", {"parameters": {"topic": "state", "n": 99}, "continues": True})
        robot.tell("news/latency", {"parameters": {"topic": "latency", "n": 99}, "continues": True})
        assert [next(stream)["n"] for _ in range(3)] == [0, 1, 2]
        robot.tell("news/events", {"parameters": {"topic": "events", "n": 3}, "continues": True})
        assert next(stream)["n"] == 3


def test_each_state_of_a_goal_is_reported_once_and_its_end_last(robot: FarRobot) -> None:
    goal = robot.answers["goal"] = GoalAnswers()
    with robot.client() as client, lease(client):
        reports = client.stream("SubmitTrajectory", trajectory=PATH)
        first = next(reports)
        second = next(reports)
        threading.Timer(3.0 * REPORTS, lambda: goal.set("succeeded", 1.0)).start()
        (last,) = reports
    assert (first["phase"], first["verdict"]) == ("accepted", {"refusals": []})
    assert (second["progress"], last["phase"], last["progress"]) == (0.1, "succeeded", 1.0)
    asked, *queries = robot.times("goal")
    assert (asked["lease"], asked["trajectory"]) == ("L1", PATH)
    assert len(queries) > 2 and all(each == {"goal": asked["goal"], "lease": "L1"} for each in queries)
    assert robot.times("lease")[-1] == {"op": "release", "lease": "L1"}


def test_a_query_of_a_state_that_is_lost_or_refused_for_load_is_repeated(
    robot: FarRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(repeated_queries, "GONE", 1.0)
    goal = GoalAnswers()
    faults = ["Busy", "lost", "Failed", "rubbish"]

    def answer(asked: dict[str, Any]) -> dict[str, Any] | None:
        if "trajectory" in asked or not faults:
            return goal(asked)
        fault = faults.pop()
        if fault == "rubbish":
            return {"phase": None}
        if fault == "lost":
            return None
        raise as_error(f"{CONTROL}.{fault}", {"what": "too much is asked"})

    robot.answers["goal"] = answer
    goal.set("aborted", 0.4)
    with robot.client() as client, lease(client):
        *_, last = client.stream("SubmitTrajectory", trajectory=PATH)
    assert last["phase"] == "aborted" and not faults


def test_a_refusal_ends_it(robot: FarRobot) -> None:
    def refuse(_asked: dict[str, Any]) -> None:
        raise as_error(f"{CONTROL}.Refused", {"findings": [{"code": "CMD_EXPIRED", "message": "too late"}]})

    robot.answers["goal"] = refuse
    with robot.client() as client, lease(client), pytest.raises(Refused, match="CMD_EXPIRED: too late"):
        list(client.stream("SubmitTrajectory", trajectory=PATH))


def test_the_lease_is_renewed_in_time_however_slowly_the_robot_answers(robot: FarRobot) -> None:
    goal = robot.answers["goal"] = GoalAnswers()
    with robot.client() as client, lease(client):
        robot.slow = 0.8 * LEASE_S
        reports = client.stream("SubmitTrajectory", trajectory=PATH)
        threading.Timer(2.5, lambda: goal.set("succeeded", 1.0)).start()
        assert list(reports)[-1]["phase"] == "succeeded"
        robot.slow = 0.0
    renewed = [at for at, part, what in robot.asked if part == "lease" and what["op"] == "renew"]
    gaps = [later - earlier for earlier, later in pairwise(renewed)]
    assert len(renewed) >= 5 and max(gaps) < LEASE_S, gaps


def test_a_client_that_stops_reading_reports_lets_the_lease_lapse(robot: FarRobot) -> None:
    robot.answers["goal"] = GoalAnswers()
    client = robot.client()
    client.call("AcquireLease")
    reports = client.stream("SubmitTrajectory", trajectory=PATH)
    next(reports)
    time.sleep(2.0 * RENEWED)
    before = len(robot.times("lease"))
    time.sleep(LEASE_S + 2.0 * RENEWED)
    assert len(robot.times("lease")) == before
    client.close()


def test_a_goal_without_replies_is_given_up_after_a_timeout(
    robot: FarRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(repeated_queries, "GONE", 1.5)
    robot.answers["goal"] = GoalAnswers()
    with robot.client() as client, lease(client):
        reports = client.stream("SubmitTrajectory", trajectory=PATH)
        next(reports)
        robot.answers = {part: lambda _: None for part in ("lease", "goal")}
        with pytest.raises(Disconnected, match="the lease has lapsed, so its motion is held"):
            list(reports)


def test_a_deadline_is_in_the_robots_clock_and_never_later_than_a_lease_from_now(robot: FarRobot) -> None:
    """However long the grant was on its way: each way takes the time that it takes."""
    for slow in (0.0, 0.4):
        robot.slow = slow
        goal = robot.answers["goal"] = GoalAnswers()
        with robot.client() as client, lease(client):
            sent = time.monotonic()
            reports = client.stream("SubmitTrajectory", trajectory=PATH)
            next(reports)
            deadline = next(each["deadline"] for each in reversed(robot.times("goal")) if "deadline" in each)
            goal.set("succeeded", 1.0)
            list(reports)
        assert deadline <= sent + 0.1 + CLOCK + LEASE_S
        assert deadline >= sent + CLOCK + LEASE_S - slow - 1.0


def test_clients_of_one_session_do_not_wait_for_each_other(robot: FarRobot) -> None:
    quick_answered = threading.Event()

    def slowly(_asked: dict[str, Any]) -> dict[str, Any]:
        assert quick_answered.wait(20.0)
        return {"slow": True}

    robot.answers |= {"ask/GetRobot": slowly, "ask/GetStatus": lambda _: {"quick": True}}
    with open_now(robot.place, 5.0) as session:
        way = SharedSession(session, "loopback")
        answers: list[Any] = []
        asking = threading.Thread(target=lambda: answers.append(client("r1", way).call("GetRobot")))
        asking.start()
        until(lambda: robot.times("ask/GetRobot"), 10.0, "the slow one is asked")
        with client("r1", way) as quick:
            assert quick.call("GetStatus") == {"quick": True}
            assert answers == []
        quick_answered.set()
        asking.join(20.0)
        assert answers == [{"slow": True}]
    with pytest.raises(Disconnected, match="the network was left"):
        client("r1", way).call("GetStatus")


def test_invalid_bytes_from_the_network_end_a_stream_and_not_the_process(robot: FarRobot) -> None:
    with robot.client() as client:
        stream = client.stream("Monitor", topics=["events"])
        time.sleep(0.3)
        robot.tell("news/events", b"\xff\xfe")
        with pytest.raises(Disconnected, match="is no valid message"):
            next(stream)
