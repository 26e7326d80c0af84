"""One run of a bridge: a graph that is lost and joined again, a back end that fails, rights that it has not.

The daemon's front is a real process; the graph is the test's.
"""

import json
import socket
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest

from tests.support.loop_stand_in import StandIn
from tests.support.processes import until
from twind.bridge.commands.leased_motions import MotionRequest
from twind.bridge.ros import ros_bridge
from twind.bridge.ros.ros_bridge import RosBridge
from twind.bridge.ros.ros_diagnostics import ERROR
from twind.bridge.ros.ros_endpoints import (
    DESCRIBED,
    DIAGNOSTICS,
    E_STOP,
    HW_JOINTS,
    LATENCIES,
    NEIGHBOURS,
    RESULTS,
    SERVICES,
    SET_MODE,
    STATUS,
    STOP,
    TO_E_STOP,
    TO_STOP,
    TOPICS,
    TRAJECTORY,
    RosService,
    RosTopic,
)
from twind.bridge.ros.ros_transport import MessageHandler, RequestHandler, answer_to
from twind.exceptions import OperationFailed
from twind.ros import JOINT_STATE, STRING, decode, encode


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bridge does not wait a second until it joins the graph again."""
    monkeypatch.setattr(ros_bridge, "AGAIN", 0.2)


def text(words: str) -> bytes:
    return encode(STRING, {"data": words})


class Paper:
    """A graph that writes down what is published. `broken`: why it cannot be joined, or was lost."""

    refuses = ""
    node = "/twind"

    def __init__(self) -> None:
        self.said: dict[str, list[bytes]] = {}
        self.broken = ""
        self.opened = 0
        self.closed = 0
        self.dropped = 0
        self.topics: Sequence[RosTopic] = ()
        self.services: Sequence[RosService] = ()
        self.hang = threading.Event()
        self.hang.set()

    def open(
        self,
        topics: Sequence[RosTopic],
        services: Sequence[RosService],
        handler: MessageHandler,
        asked: RequestHandler,
    ) -> None:
        if self.broken:
            raise OperationFailed(self.broken)
        self.topics = topics
        self.services = services
        self.heard = handler
        self.asked = asked
        self.opened += 1

    def publish(self, topic: RosTopic, data: bytes) -> None:
        if self.broken:
            raise OperationFailed(self.broken)
        self.said.setdefault(topic.name, []).append(data)

    def show(self, topic: RosTopic, content: object) -> None: ...

    def close(self) -> None:
        self.hang.wait(20.0)
        self.closed += 1

    def last(self, topic: RosTopic) -> Any:
        """The newest message of a topic, once there is one."""
        until(lambda: self.said.get(topic.name), 20.0, f"something on {topic.name}")
        return decode(topic.kind, self.said[topic.name][-1])

    def words(self, topic: RosTopic) -> Any:
        return json.loads(self.last(topic)["data"])


class Run:
    """A course in a thread."""

    def __init__(self, sockets: Path, **options: Any) -> None:
        self.graph = Paper()
        self.lines = list[str]()
        self.stop = threading.Event()
        self.course = RosBridge(self.graph, str(sockets), tell=self.lines.append, stop=self.stop, **options)
        self.code: int | None = None
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        self.code = self.course.run()

    def outcome(self, topic: RosTopic, data: bytes) -> Any:
        """Result of a command that the graph sends."""
        before = len(self.graph.said.get(RESULTS.name, ()))
        self.graph.heard(topic, data)
        until(
            lambda: len(self.graph.said.get(RESULTS.name, ())) > before, 20.0, f"an outcome of {topic.name}"
        )
        return json.loads(decode(STRING, self.graph.said[RESULTS.name][before])["data"])

    def __enter__(self) -> "Run":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop.set()
        self._thread.join(20.0)
        assert self.code == 0


def test_daemon_data_is_published_on_its_topics(loop: StandIn) -> None:
    with Run(loop.directory) as run:
        measured = run.graph.last(HW_JOINTS)
        assert len(measured["name"]) == 23  # of 24, whose last was not heard
        assert run.graph.last(LATENCIES)["layout"]["dim"][0]["label"] == "hop: bus"
        status = run.graph.words(STATUS)
        until(lambda: run.graph.words(STATUS)["bridge"]["daemon"], 10.0, "the daemon is there")
        until(lambda: "mode" in run.graph.words(STATUS), 10.0, "its status")
        names = [row["name"] for row in run.graph.last(DIAGNOSTICS)["status"]]
        assert names[0] == "twind: bridge" and status["bridge"]["commands"]
        plain = [each for each in TOPICS if each not in DESCRIBED]  # no interpreter describes the robot
        assert list(run.graph.topics) == [*plain, NEIGHBOURS]
        assert list(run.graph.services) == list(SERVICES)


def test_a_rate_is_that_of_the_readings(loop: StandIn) -> None:
    with Run(loop.directory, rate=10.0) as run:
        run.graph.last(HW_JOINTS)
        until(lambda: len(run.graph.said[HW_JOINTS.name]) > 5, 30.0, "some")
        stamps = [decode(JOINT_STATE, data)["header"]["stamp"] for data in run.graph.said[HW_JOINTS.name]]
        times = [each["sec"] + each["nanosec"] / 1e9 for each in stamps]
        assert (times[-1] - times[0]) / (len(times) - 1) > 0.05


def test_a_graph_that_is_lost_is_joined_again_and_has_the_status(loop: StandIn) -> None:
    with Run(loop.directory) as run:
        run.graph.last(HW_JOINTS)
        run.graph.broken = "dds: the cable"
        told = "dds: the cable; tried again"
        until(lambda: told in run.lines, 10.0, "it is told")
        time.sleep(0.3)
        assert run.lines.count(told) == 1  # once, however many messages there are
        run.graph.said.clear()
        run.graph.broken = ""
        run.graph.last(STATUS)
        until(lambda: "the graph is joined again" in run.lines, 10.0, "it is told")
        assert run.graph.opened == 2


def test_a_graph_that_cannot_be_joined_at_first_is_tried_again(loop: StandIn) -> None:
    run = Run(loop.directory)
    run.graph.broken = "dds: domain 7: no participant"
    with run:
        until(lambda: run.lines, 10.0, "it is told")
        run.graph.broken = ""
        run.graph.last(HW_JOINTS)


def test_a_bridge_without_commands_executes_e_stops_and_refuses_all_else_with_the_reason(
    loop: StandIn,
) -> None:
    with Run(loop.directory, commands=False) as run:
        run.graph.last(HW_JOINTS)
        assert run.graph.words(STATUS)["bridge"]["commands"] is False
        for topic, data in ((TRAJECTORY, b"\0\1\0\0"), (STOP, b""), (SET_MODE, text("live"))):
            told = run.outcome(topic, data)
            assert told["phase"] == "refused" and "only reads: --no-commands" in told["message"]
        assert answer_to(run.graph.asked, TO_STOP, None)[0] is False
        assert run.outcome(E_STOP, b"")["phase"] == "done"


def test_a_back_end_without_commands_states_the_reason_in_the_status(loop: StandIn) -> None:
    run = Run(loop.directory)
    run.graph.refuses = "this middleware loses commands"
    run.course = RosBridge(run.graph, str(loop.directory), tell=run.lines.append, stop=run.stop)
    with run:
        bridge = run.graph.words(STATUS)["bridge"]
        assert bridge["commands"] is False
        assert bridge["refuses"] == "this bridge only reads: this middleware loses commands"
        run.graph.heard(NEIGHBOURS, text(json.dumps({"bridge": {"id": "abc", "commands": True}})))
        run.graph.last(HW_JOINTS)
        time.sleep(ros_bridge.AGAIN)
    assert not any(line.startswith("another bridge") for line in run.lines)


def test_without_the_right_to_command_it_takes_nothing_that_does(loop: StandIn, tmp_path: Path) -> None:
    (tmp_path / "observe.sock").symlink_to(loop.directory / "observe.sock")
    (tmp_path / "control.sock").symlink_to(loop.directory / "observe.sock")  # whose role is an observer's
    with Run(tmp_path) as run:
        run.graph.last(HW_JOINTS)
        until(lambda: not run.graph.words(STATUS)["bridge"]["commands"], 10.0, "an e-stop alone")
        told = run.outcome(TRAJECTORY, b"\0\1\0\0")
        assert told["phase"] == "refused" and "not for the role observer" in told["message"]
        assert any("not for the role observer" in line for line in run.lines)
        until(lambda: run.course.asked_of == 1, 10.0, "asked once more")
        (tmp_path / "control.sock").unlink()
        (tmp_path / "control.sock").symlink_to(loop.directory / "control.sock")
        run.course.asked_of = -1  # as for a new daemon
        until(lambda: run.graph.words(STATUS)["bridge"]["commands"], 10.0, "commands")
        assert "commands are taken from ROS" in run.lines


def test_a_message_that_cannot_be_decoded_is_reported_and_the_rest_continues(
    loop: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twind.bridge.ros.ros_bridge.latencies", lambda hops: hops["none"])
    with Run(loop.directory) as run:
        until(lambda: run.lines, 10.0, "it is told")
        assert "cannot be decoded: TypeError" in run.lines[0]
        run.graph.said.clear()
        run.graph.last(HW_JOINTS)


def test_an_absent_daemon_is_reported_in_log_and_status(tmp_path: Path) -> None:
    with Run(tmp_path) as run:
        until(lambda: run.lines, 10.0, "it is told")
        until(lambda: run.graph.words(STATUS)["bridge"]["error"], 10.0, "so is the graph")
        bridge = run.graph.words(STATUS)["bridge"]
        assert not bridge["daemon"] and "no daemon" in bridge["error"]
        assert "waiting for the daemon" in run.lines[0]
        assert answer_to(run.graph.asked, TO_E_STOP, None)[0] is False


def test_a_back_end_that_hangs_at_the_end_is_left_behind(loop: StandIn) -> None:
    run = Run(loop.directory)
    with run:
        run.graph.last(HW_JOINTS)
        run.graph.hang.clear()
    assert run.graph.closed == 1  # at the start, before it was joined
    run.graph.hang.set()


def test_a_command_that_raises_an_error_does_not_prevent_the_next(loop: StandIn) -> None:
    with Run(loop.directory) as run:
        run.graph.last(HW_JOINTS)

        def broken(request: MotionRequest) -> None:
            motions.take = take  # type: ignore[method-assign]
            raise ZeroDivisionError

        motions = run.course.commands.motions
        take = motions.take
        motions.take = broken  # type: ignore[method-assign]
        run.graph.heard(TRAJECTORY, b"\0\1\0\0" + bytes(7))
        until(lambda: run.lines, 10.0, "it is told")
        assert "trajectories: ZeroDivisionError" in run.lines[0]
        run.graph.heard(TRAJECTORY, b"\0\1\0\0" + bytes(7))
        until(lambda: run.graph.said.get(RESULTS.name), 10.0, "an outcome")
        assert decode(STRING, run.graph.said[RESULTS.name][0])


def test_a_stalled_loop_is_not_reported_as_healthy(tmp_path: Path) -> None:
    stand_in = StandIn(tmp_path)
    try:
        with Run(tmp_path) as run:
            until(lambda: len(run.graph.last(DIAGNOSTICS)["status"]) > 24, 20.0, "all rows")
            # type: ignore[method-assign]
            send = stand_in.send
            stand_in.send = lambda message: None
            until(lambda: len(run.graph.last(DIAGNOSTICS)["status"]) == 1, 4.0, "the bridge's row alone")
            (row,) = run.graph.last(DIAGNOSTICS)["status"]
            assert row["level"] == ERROR and "no message of the loop" in row["message"]
            told = run.graph.words(STATUS)
            assert list(told) == ["bridge"] and not told["bridge"]["daemon"]
            stand_in.send = send  # type: ignore[method-assign]
            until(lambda: len(run.graph.last(DIAGNOSTICS)["status"]) > 24, 20.0, "all rows again")
            until(lambda: "mode" in run.graph.words(STATUS), 10.0, "the status again")
    finally:
        stand_in.close()


def test_a_status_that_is_not_understood_costs_the_diagnostics_and_no_more(
    loop: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twind.bridge.ros.ros_diagnostics._robot", lambda status: status["none"])
    with Run(loop.directory) as run:
        until(lambda: run.lines, 10.0, "it is told")
        assert run.lines[0] == "KeyError: 'none'; tried again"
        run.graph.said.clear()
        run.graph.last(HW_JOINTS)


def test_the_last_status_of_a_bridge_states_that_daemon_and_commands_are_gone(loop: StandIn) -> None:
    with Run(loop.directory) as run:
        until(lambda: "mode" in run.graph.words(STATUS), 20.0, "a status")
    told = run.graph.words(STATUS)
    assert list(told) == ["bridge"] and not told["bridge"]["daemon"] and not told["bridge"]["commands"]


def test_messages_without_a_reader_are_counted_in_the_status(loop: StandIn) -> None:
    with Run(loop.directory) as run:
        run.graph.dropped = 7
        until(lambda: run.graph.words(STATUS)["bridge"]["undelivered"] == 7, 10.0, "it is told")


def test_an_e_stop_does_not_wait_for_a_socket_whose_queue_is_full(loop: StandIn, tmp_path: Path) -> None:
    (tmp_path / "control.sock").symlink_to(loop.directory / "control.sock")
    with socket.socket(socket.AF_UNIX) as full, ExitStack() as waiting:
        full.bind(str(tmp_path / "observe.sock"))
        full.listen(0)
        for _ in range(3):
            each = waiting.enter_context(socket.socket(socket.AF_UNIX))
            each.setblocking(False)
            with suppress(BlockingIOError):
                each.connect(str(tmp_path / "observe.sock"))
        course = RosBridge(Paper(), str(tmp_path), tell=print, stop=threading.Event())
        course.commands.start()
        begun = time.monotonic()
        done, words = answer_to(course.commands.on_request, TO_E_STOP, None)
        assert done, words
        assert time.monotonic() - begun < 15.0  # and not the 35 s that an answer may take


def test_two_bridges_with_commands_move_nothing_until_one_is_gone(loop: StandIn) -> None:
    with Run(loop.directory) as run:
        until(lambda: "mode" in run.graph.words(STATUS), 20.0, "a status")
        ours = run.graph.said[STATUS.name][-1]
        run.graph.heard(NEIGHBOURS, ours)  # of itself
        assert "another bridge" not in run.outcome(TRAJECTORY, b"\0\1\0\0")["message"]
        theirs = {"robot": "right", "bridge": {"id": "abc", "commands": True}}
        run.graph.heard(NEIGHBOURS, text(json.dumps(theirs)))
        told = run.outcome(TRAJECTORY, b"\0\1\0\0")
        assert told["phase"] == "refused" and "right (bridge abc)" in told["message"]
        assert told["robot"] == run.graph.words(STATUS)["robot"]
        assert told["bridge"] == run.graph.words(STATUS)["bridge"]["id"]
        assert run.outcome(SET_MODE, text("live"))["phase"] == "refused"
        assert "only stops are done" not in run.outcome(STOP, b"")["message"]
        until(lambda: any(each.startswith("another bridge") for each in run.lines), 10.0, "it is told")
        theirs["bridge"] = {"id": "abc", "commands": False}
        run.graph.heard(NEIGHBOURS, text(json.dumps(theirs)))
        assert "another bridge" not in run.outcome(TRAJECTORY, b"\0\1\0\0")["message"]
        until(lambda: any("is gone" in each for each in run.lines), 10.0, "it is told")


def test_the_result_of_a_command_is_logged(loop: StandIn) -> None:
    with Run(loop.directory) as run:
        run.graph.last(HW_JOINTS)
        run.graph.heard(TRAJECTORY, b"\0\1\0\0" + bytes(7))
        until(lambda: any("/cmd/joint_trajectory: refused: " in each for each in run.lines), 10.0, "a line")
