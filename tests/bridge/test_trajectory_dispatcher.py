"""Commands from ROS: each meets the gate or is refused, and its sender gets a report."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.support.ros_trajectory_messages import NOW, command, point
from tests.support.scripted_line import ScriptedDaemon, ended, ended_in_words, moving
from twind.bridge.ros import trajectory_dispatcher
from twind.bridge.ros.ros_command_queue import PACE, ROOM
from twind.bridge.ros.ros_trajectory import LONGEST
from twind.bridge.ros.trajectory_dispatcher import MORE, PATIENT, TrajectoryDispatcher

FAR: Any = ("Refused", {"findings": [{"code": "POS_LIMIT", "joint": "l_knee", "message": "l_knee: 9 rad"}]})
HELD: Any = ("LeaseHeld", {"lease": {"holder": "uid 7, pid 8", "uid": 7, "expires_in": 0.5}})
READ_ONLY: Any = ("NotAllowed", {"role": "observer", "method": "AcquireLease"})
GOOD = command(point(1.0), frame="mine", when=NOW)


class Desk:
    """Orders whose time the test moves, and the daemon that they go to."""

    def __init__(self) -> None:
        self.time = 100.0
        self.daemon = ScriptedDaemon()
        self.results: list[dict[str, Any]] = []
        self.orders = TrajectoryDispatcher(
            self.daemon.client, self.results.append, lambda: NOW, lambda: self.time
        )

    def after(self, seconds: float = PACE) -> list[str]:
        """Return the phases reported in the next `seconds`."""
        before = len(self.results)
        for _ in range(max(1, round(seconds / PACE))):
            self.time += PACE
            self.orders.step(0.0)
        return [each["phase"] for each in self.results[before:]]


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_an_accepted_command_is_reported_to_its_end_with_its_own_stamp(desk: Desk) -> None:
    desk.orders.put(GOOD)
    assert desk.after() == ["accepted"]
    desk.orders.on_monitor_reply(ended("m1", "succeeded"))
    assert desk.after() == ["succeeded"]
    for told in desk.results:
        assert told["topic"] == "/cmd/joint_trajectory" and told["frame_id"] == "mine" and told["id"] == "m1"
        assert told["stamp"] == {"sec": NOW // 10**9, "nanosec": NOW % 10**9}
    (asked,) = desk.daemon.named("SubmitTrajectory")
    assert asked["trajectory"]["points"] == [{"positions": [0.5], "time_from_start": 1.0}]


@pytest.mark.parametrize(
    ("data", "refuse", "message"),
    [
        (command(point(1.0, [float("nan")])), {}, "positions is nan"),
        (GOOD, {"SubmitTrajectory": FAR}, "POS_LIMIT: l_knee: 9 rad"),
        (GOOD, {"AcquireLease": HELD}, "held by uid 7, pid 8, which keeps it"),
        (GOOD, {"AcquireLease": READ_ONLY}, "control.sock"),
    ],
)
def test_a_refused_command_is_reported_with_the_reason(
    desk: Desk, data: bytes, refuse: dict[str, Any], message: str
) -> None:
    desk.daemon.refuse = refuse
    desk.orders.put(data)
    assert desk.after() == ["refused"]
    assert message in desk.results[0]["message"]
    assert desk.orders.driving == ()


def test_without_a_daemon_commands_are_refused_and_not_kept_for_later(desk: Desk) -> None:
    desk.daemon.absent = True
    desk.orders.put(GOOD)
    assert desk.after() == ["refused"] and desk.results[0]["message"] == "nobody listens"
    desk.daemon.absent = False
    assert desk.after(2.0) == []


def test_a_command_that_waited_too_long_expires(desk: Desk) -> None:
    desk.orders.put(command(point(1.0)))
    desk.time += PATIENT + 0.1
    assert desk.after() == ["refused"] and desk.results[0]["findings"][0]["code"] == "CMD_EXPIRED"


def test_a_command_flood_reaches_the_daemon_at_a_bounded_rate_and_drops_are_reported(desk: Desk) -> None:
    for place in range(500):
        for _ in range(4):
            desk.orders.put(command(point(1.0), joints=(f"joint_{place % 20}",)))
        if place % 10 == 0:
            desk.after()
    desk.after(2.0)
    asked = len(desk.daemon.named("SubmitTrajectory"))
    assert asked <= 500 / 10 + 2.0 / PACE
    assert sum(each.get("count", 1) for each in desk.results) == 2000  # each command is reported
    assert len([each for each in desk.results if each["phase"] == "dropped"]) <= 500 / 10 * PACE + 4


def test_a_stop_comes_before_what_was_asked_for_before_it(desk: Desk) -> None:
    desk.orders.put(GOOD)
    desk.orders.stop()
    assert desk.after() == ["refused"] and "stopped" in desk.results[0]["message"]
    assert not desk.daemon.named("SubmitTrajectory")
    desk.orders.put(GOOD)
    assert desk.after() == ["accepted"]


def test_a_stop_while_a_command_is_judged_wins(desk: Desk) -> None:
    desk.daemon.meanwhile = lambda method: desk.orders.stop() if method == "SubmitTrajectory" else None
    desk.orders.put(GOOD)
    assert desk.after() == ["accepted"]
    assert [method for method, _ in desk.daemon.calls][-1] == "Cancel"


def test_a_failed_cancel_request_releases_the_lease(desk: Desk) -> None:
    def stopping(method: str) -> None:
        if method == "SubmitTrajectory":
            desk.orders.stop()
            desk.daemon.refuse["Cancel"] = ("Busy", {"what": "the loop"})

    desk.daemon.meanwhile = stopping
    desk.orders.put(GOOD)
    desk.after()
    assert desk.daemon.calls[-1][0] == "ReleaseLease" and desk.daemon.open == 0


def followed(desk: Desk, **more: Any) -> tuple[list[str], Callable[[], None]]:
    phases: list[str] = []
    cancel = desk.orders.goal(GOOD, lambda result: phases.append(result["phase"]), **more)
    return phases, cancel


def test_a_goal_is_followed_to_its_end_with_its_tolerances(desk: Desk) -> None:
    tolerances = [{"joint": "l_knee", "goal": 0.1}]
    phases, _ = followed(desk, goal_time=2.0, tolerances=tolerances)
    desk.after(2.5)
    desk.orders.on_monitor_reply(ended("m1", "aborted", {"code": "GOAL_TOLERANCE", "message": "off"}))
    desk.after()
    assert phases[0] == "accepted" and phases[-1] == "aborted" and set(phases[1:-1]) == {"running"}
    (asked,) = desk.daemon.named("SubmitTrajectory")
    assert asked["trajectory"]["goal_time"] == 2.0 and asked["trajectory"]["tolerances"] == tolerances


def test_a_goal_is_cancelled_before_it_begins_and_while_it_runs(desk: Desk) -> None:
    phases, cancel = followed(desk)
    cancel()
    desk.after()
    assert phases == ["cancelled"] and not desk.daemon.named("SubmitTrajectory")
    phases, cancel = followed(desk)
    desk.after()
    cancel()
    desk.after()
    assert desk.daemon.named("Cancel")
    desk.orders.on_monitor_reply(ended("m1", "cancelled"))
    desk.after()
    assert phases[-1] == "cancelled"


def test_a_goal_that_finds_no_room_is_refused(desk: Desk) -> None:
    first, _ = followed(desk)
    for _ in range(ROOM):
        followed(desk)
    assert first == ["refused"]


def for_joints(desk: Desk, *joints: str) -> None:
    for joint in joints:
        desk.orders.put(command(point(1.0), joints=(joint,), frame=joint))


@pytest.mark.parametrize(
    "stop",
    [
        lambda desk: desk.orders.on_monitor_reply(ended("m1", "cancelled", time=desk.time)),
        lambda desk: desk.orders.on_monitor_reply(ended("of_another", "aborted", time=desk.time)),
        lambda desk: desk.orders.on_monitor_reply(ended("", "aborted", time=desk.time)),
        lambda desk: desk.orders.on_monitor_reply(
            ended("of_another", "a phase of later versions", time=desk.time)
        ),
        lambda desk: desk.orders.on_monitor_reply(
            {"topic": "events", "time": desk.time, "event": {"code": "LEASE_LOST", "message": "lease taken"}}
        ),
    ],
)
def test_a_foreign_stop_refuses_the_commands_submitted_before_it(
    desk: Desk, stop: Callable[[Desk], None]
) -> None:
    for_joints(desk, "a", "b", "c")
    assert desk.after() == ["accepted"]
    stop(desk)
    assert [each for each in desk.after(1.0) if each != "cancelled"][:2] == ["refused", "refused"]
    assert len(desk.daemon.named("SubmitTrajectory")) == 1
    for_joints(desk, "d")
    assert desk.after() == ["accepted"]


def test_a_motion_accepted_between_a_stop_and_its_event_is_cancelled(desk: Desk) -> None:
    for_joints(desk, "a", "b")
    desk.after()
    stopped = desk.time
    assert desk.after() == ["accepted"] and not desk.daemon.named("Cancel")
    desk.orders.on_monitor_reply(ended("m1", "cancelled", time=stopped))
    desk.after()
    assert len(desk.daemon.named("Cancel")) == 1
    desk.orders.on_monitor_reply(ended("m2", "cancelled", time=desk.time))
    for_joints(desk, "c")
    desk.time += 0.01
    for_joints(desk, "d")
    desk.after(1.0)
    assert desk.results[-1]["frame_id"] == "d" and desk.results[-1]["phase"] == "accepted"
    assert len(desk.daemon.named("Cancel")) == 1


def test_a_foreign_motion_that_is_replaced_or_succeeds_stops_no_command(desk: Desk) -> None:
    for phase in ("replaced", "succeeded"):
        for_joints(desk, "a")
        desk.orders.on_monitor_reply(ended("x1", phase, time=desk.time))
        assert desk.after() == ["accepted"]


def test_a_command_for_one_mode_does_not_begin_in_another(desk: Desk) -> None:
    desk.orders.on_monitor_reply(moving("holding", "sim", desk.time))
    desk.time += 0.1
    desk.orders.on_monitor_reply(moving("holding", "sim", desk.time))
    for_joints(desk, "a")
    desk.time += 0.1
    desk.orders.on_monitor_reply(moving("holding", "sim", desk.time))
    desk.orders.on_monitor_reply(moving("holding", "live", desk.time + 0.1))
    assert desk.after() == ["refused"]
    desk.time += 0.05
    for_joints(desk, "a")
    assert desk.after() == ["accepted"]


def test_after_the_cancel_of_a_goal_the_next_one_begins(desk: Desk) -> None:
    _, cancel = followed(desk)
    desk.after()
    cancel()
    phases, _ = followed(desk)
    desk.time += 0.01
    desk.orders.on_monitor_reply(ended("m1", "cancelled", time=desk.time))
    desk.after()
    assert phases == ["accepted"]


def test_a_goal_is_cancelled_while_another_path_is_judged(desk: Desk) -> None:
    _, cancel = followed(desk)
    desk.after()
    open_then = list[int]()

    def judging(method: str) -> None:
        if method == "SubmitTrajectory":
            desk.daemon.meanwhile = lambda method: open_then.append(desk.daemon.open)
            cancel()
            desk.daemon.meanwhile = lambda method: None

    desk.daemon.meanwhile = judging
    desk.orders.put(GOOD)
    desk.after()
    assert open_then == [2]  # a connection of its own, and it was asked while the other was not answered


def test_a_goal_that_has_ended_is_not_cancelled_in_the_place_of_another(desk: Desk) -> None:
    _, cancel = followed(desk)
    desk.after()
    desk.orders.put(GOOD)
    desk.orders.on_monitor_reply(ended("m1", "replaced"))
    desk.after()
    cancel()
    desk.after()
    assert not desk.daemon.named("Cancel")


def test_an_internal_error_on_a_command_is_reported_to_its_sender(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.orders.put(GOOD)
    desk.after()
    monkeypatch.setattr(trajectory_dispatcher, "trajectory", lambda data, now: [][1])
    phases, _ = followed(desk)
    assert desk.after() == ["refused"] and phases == ["refused"]
    assert "IndexError" in desk.results[-1]["message"]
    assert desk.orders.driving == ("m1",)  # and what ran goes on
    monkeypatch.undo()
    monkeypatch.setattr(ScriptedDaemon, "_submitted", lambda daemon: {"phase": "accepted"})
    desk.orders.put(GOOD)
    desk.after()
    assert "KeyError" in desk.results[-1]["message"] and desk.daemon.open == 0  # it might run: it is let go


def test_long_tolerances_are_refused_before_the_socket_would_hang_up(desk: Desk) -> None:
    phases, _ = followed(desk, tolerances=[{"joint": "x" * MORE}])
    desk.after()
    assert phases == ["refused"] and "tolerances" in desk.results[0]["message"]


def test_oversized_bytes_are_neither_kept_nor_repeated_in_the_result(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[int] = []
    monkeypatch.setattr(trajectory_dispatcher, "RosCommand", lambda data, *rest: kept.append(len(data)))
    monkeypatch.setattr(desk.orders, "_put", lambda command: None)
    desk.orders.put(bytes(5 * LONGEST))
    assert kept == [LONGEST + 1]
    monkeypatch.undo()
    desk.orders.put(command(point(1.0), frame="x" * 10_000) + bytes(5 * LONGEST))
    assert desk.after() == ["refused"]
    assert len(str(desk.results[0])) < 1000 and "2097152 bytes" in desk.results[0]["message"]


def test_a_closing_bridge_reports_the_motions_it_cancels(desk: Desk) -> None:
    phases, _ = followed(desk)
    desk.after()
    desk.orders.close()
    assert phases[-1] == "cancelled" and desk.results[-1]["id"] == "m1"
    assert desk.daemon.open == 0


def test_a_motion_without_an_end_event_is_reported_as_lost(desk: Desk) -> None:
    desk.orders.put(GOOD)
    desk.after()
    desk.orders.on_monitor_reply(moving("holding"))
    desk.time += 5.0
    desk.orders.on_monitor_reply(moving("holding"))
    assert desk.after(0.2)[-1:] == ["lost"] and "no report of its end came" in desk.results[-1]["message"]


def test_a_daemon_that_reports_ends_in_words_alone_stops_what_runs_and_what_waits(desk: Desk) -> None:
    for_joints(desk, "a", "b")
    assert desk.after() == ["accepted"]
    desk.orders.on_monitor_reply(ended_in_words("of_another", "succeeded", time=desk.time))
    assert sorted(desk.after(1.0)) == ["lost", "refused"]
    assert desk.daemon.open == 0, "without a connection there is no lease, and the daemon holds"
    (lost,) = [each for each in desk.results if each["phase"] == "lost"]
    assert "versions" in lost["message"]
