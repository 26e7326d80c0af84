"""The control socket, on real bytes of a real front process; the loop behind it is a stand-in."""

import contextlib
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest
import varlink

from tests.support.loop_stand_in import NAMES, StandIn, briefing
from tests.support.processes import until
from tests.support.raw_connection import CONTRACT, Raw, code
from tests.support.scenes_front import SCENES
from tests.support.shared_front import SharedFront
from twind import link
from twind.protocol import CONTROL, SERVICE
from twind.robot.finding import ReasonCode

# --------------------------------------------------------------------------- an independent client


def test_varlink_introspects_calls_and_streams(loop: StandIn) -> None:
    with varlink.Client(f"unix:{loop.directory}/control.sock") as client:
        info = client.get_interfaces()
        assert set(info) == {SERVICE, CONTROL}
        assert client.get_interface(CONTROL).description == CONTRACT.description
        with client.open(CONTROL) as robot:
            assert robot.GetStatus()["status"]["state"] == "armed"
            assert [joint["name"] for joint in robot.GetStatus(True)["joints"]] == NAMES
            sequences = [
                news["sequence"]
                for news, _ in zip(robot.Monitor(["state"], 100.0, _more=True), range(5), strict=False)
            ]
            assert sequences == sorted(set(sequences))


def test_varlink_understands_our_errors(loop: StandIn) -> None:
    with varlink.Client(f"unix:{loop.directory}/observe.sock") as client, client.open(CONTROL) as robot:
        with pytest.raises(varlink.VarlinkError) as caught:
            robot.Arm()
        assert caught.value.error() == f"{CONTROL}.NotAllowed"
        assert caught.value.parameters() == {"role": "observer", "method": "Arm"}
        with pytest.raises(varlink.VarlinkError) as caught:
            robot.Monitor(topics=["rough"])
        known = ["state", "latency", "status", "raw", "events", "verdicts", "trajectories", "stream"]
        assert caught.value.parameters()["known"] == known


# --------------------------------------------------------------------------- what is answered here


def test_a_status_is_refused_while_the_loop_reports_nothing(tmp_path: Path) -> None:
    """A loop that hangs would pass for one whose readings are new and whose robot is armed."""
    stand_in = StandIn(tmp_path)
    with Raw(stand_in) as client:
        assert client.call("GetStatus")["parameters"]["status"]["armed"]
        stand_in.rate = 0.3  # its next report is 3.3 s ahead
        time.sleep(2.5)
        refused = client.call("GetStatus")
        assert refused["error"] == f"{CONTROL}.Busy"
        assert "bound 2 s" in refused["parameters"]["what"]
        until(lambda: "error" not in client.call("GetStatus"), 5.0, "its next report")
    assert stand_in.close() == 0


@pytest.mark.parametrize("name", ["control", "observe"])
@pytest.mark.parametrize(
    ("method", "parameters"),
    [("GetStatus", {}), ("GetStatus", {"joints": True}), ("GetRobot", {}), ("GetParameters", {})],
)
def test_reading_methods_reply_as_the_interface_defines(
    loop: StandIn, name: str, method: str, parameters: dict[str, Any]
) -> None:
    with Raw(loop, name) as client:
        answer = client.call(method, **parameters)
        assert set(answer) == {"parameters"}
        CONTRACT.methods[method].results.check(answer["parameters"], "")
    assert not [command for command in loop.commands if isinstance(command, link.Command)]


def test_an_unknown_value_is_null(loop: StandIn) -> None:
    with Raw(loop) as client:
        answer = client.call("GetStatus", joints=True)["parameters"]
    last = answer["joints"][-1]
    first = answer["joints"][0]
    assert (last["position"], last["age_ms"], last["heard"], last["torque"]) == (None, None, False, None)
    assert (last["faults"], first["faults"]) == ([], ["overheating", "overload"])
    assert (first["effort"], first["age_ms"], first["torque"]) == (None, 10.0, True)
    assert answer["status"]["latency_max_ms"] is None
    assert answer["status"]["faults"][0]["joint"] == NAMES[3]


@pytest.mark.parametrize("topic", ["state", "latency", "status", "raw"])
def test_a_topic_arrives_at_its_rate_as_the_interface_defines(loop: StandIn, topic: str) -> None:
    with Raw(loop) as client:
        client.send("Monitor", parameters={"topics": [topic], "rate": 10.0}, more=True)
        times = []
        for _ in range(4):
            message = client.receive()
            assert message["continues"] is True
            CONTRACT.methods["Monitor"].results.check(message["parameters"], "")
            assert message["parameters"]["dropped"] == 0
            times.append(message["parameters"]["time"])
    steps = [after - before for before, after in pairwise(times)]
    assert 0.05 < sum(steps) / len(steps) < 0.2


def test_how_far_apart_the_buses_were_read_is_in_status_and_state(loop: StandIn) -> None:
    with Raw(loop) as client:
        status = client.call("GetStatus")["parameters"]["status"]
        state = client.call("Monitor", topics=["state"])["parameters"]
    assert (status["skew_ms"], status["skew_max_ms"]) == (1.5, 2.5)
    assert state["skew_ms"] == 1.5 and state["mode"] == "live"
    assert len(state["joints"]) == 24


def test_events_and_verdicts_reach_those_who_watch_them(loop: StandIn) -> None:
    finding = {"code": "POS_LIMIT", "joint": 2, "value": 2.0, "bound": 1.0}
    with Raw(loop) as client:
        client.send("Monitor", parameters={"topics": ["events", "verdicts"]}, more=True)
        time.sleep(0.05)
        loop.send(link.Event(time=1.0, sequence=7, level="info", code="TEST", message="hello"))
        loop.send(link.VerdictReport(time=2.0, sequence=8, id="x", verdict={"refusals": [finding]}))
        event = client.receive()["parameters"]
        verdict = client.receive()["parameters"]
    assert (event["topic"], event["sequence"], event["event"]["message"]) == ("events", 7, "hello")
    assert verdict["verdict"]["refusals"][0]["joint"] == NAMES[2]


@pytest.mark.parametrize(("rate", "topics"), [(0.0, ["state"]), (-1.0, ["state"]), (1.0, [])])
def test_a_monitor_of_nothing_is_refused(loop: StandIn, rate: float, topics: list[str]) -> None:
    with Raw(loop) as client:
        answer = client.call("Monitor", topics=topics, rate=rate)
    assert answer["error"] == f"{SERVICE}.InvalidParameter"


# --------------------------------------------------------------------------- bytes


@pytest.mark.parametrize("end", [b"\0", b"\n"])
def test_the_first_terminator_decides_and_answers_end_with_it(loop: StandIn, end: bytes) -> None:
    with Raw(loop, end=end) as client:
        for _ in range(3):
            assert client.call("GetInfo")["parameters"]["vendor"] == "twind"


def test_with_newlines_blank_lines_and_carriage_returns_do_no_harm(loop: StandIn) -> None:
    with Raw(loop, end=b"\n") as client:
        client.bytes(b'\r\n\n{"method":"org.varlink.service.GetInfo"}\r\n')
        assert client.receive()["parameters"]["vendor"] == "twind"


def test_with_nul_a_message_may_span_lines_after_the_first(loop: StandIn) -> None:
    with Raw(loop) as client:
        assert client.call("GetInfo")
        client.bytes(b'{\n"method":"org.varlink.service.GetInfo"\n}\0')
        assert client.receive()["parameters"]["vendor"] == "twind"


@pytest.mark.parametrize("parameters", [b"", b',"parameters":null', b',"parameters":{}'])
def test_no_parameters_come_in_three_shapes(loop: StandIn, parameters: bytes) -> None:
    with Raw(loop) as client:
        client.bytes(b'{"method":"io.twind.Control.GetParameters"' + parameters + b"}\0")
        assert "error" not in client.receive()


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (b'{"method":"a","method":"b"}', "BAD_JSON"),
        (b'{"method":"io.twind.Control.Setpoint","parameters":{"positions":[NaN]}}', "BAD_JSON"),
        (b'{"method":"io.twind.Control.Setpoint","parameters":{"positions":[1e999]}}', "BAD_JSON"),
        (b"[" * 20 + b"]" * 20, "BAD_JSON"),
        (b"\xff\xfe", "BAD_JSON"),
        (b"[]", "BAD_SCHEMA"),
        (b"{}", "BAD_SCHEMA"),
        (b'{"method":1}', "BAD_SCHEMA"),
        (b'{"method":"a.B","id":1}', "BAD_SCHEMA"),
        (b'{"method":"a.B","parameters":[]}', "BAD_SCHEMA"),
        (b'{"method":"a.B","more":1}', "BAD_SCHEMA"),
        (b'{"method":"a.B","more":true,"oneway":true}', "BAD_SCHEMA"),
        (b'{"method":"a.B","upgrade":true}', "BAD_SCHEMA"),
    ],
)
def test_an_invalid_message_is_refused_and_the_next_call_answered(
    loop: StandIn, message: bytes, expected: str
) -> None:
    with Raw(loop) as client:
        client.bytes(message + b"\0")
        assert code(client.receive()) == expected
        assert client.call("GetInfo")["parameters"]["vendor"] == "twind"
    assert not [command for command in loop.commands if isinstance(command, link.Command)]


def test_a_client_that_sends_only_invalid_messages_is_disconnected(loop: StandIn) -> None:
    with Raw(loop) as client:
        client.bytes(b"?\0" * 10)
        assert [code(client.receive()) for _ in range(10)] == ["BAD_JSON"] * 10
        assert client.ended()


@pytest.mark.parametrize(
    ("method", "parameters", "name"),
    [
        ("SetMode", {"mode": 1}, "mode"),
        ("SetMode", {}, "mode"),
        ("GetStatus", {"joints": 1}, "joints"),
        ("Disarm", {"now": True}, "now"),
        ("Scan", {"bauds": [57600]}, "bauds"),
        ("GetInterfaceDescription", {"interface": None}, "interface"),
    ],
)
def test_a_wrong_parameter_is_named(
    loop: StandIn, method: str, parameters: dict[str, Any], name: str
) -> None:
    with Raw(loop) as client:
        answer = client.call(method, **parameters)
    assert answer["error"] == f"{SERVICE}.InvalidParameter"
    assert answer["parameters"]["parameter"] == name
    assert answer["parameters"]["message"]


def test_unknown_methods_and_interfaces_are_reported(loop: StandIn) -> None:
    with Raw(loop) as client:
        assert client.call("Fly") == {
            "error": f"{SERVICE}.MethodNotFound",
            "parameters": {"method": f"{CONTROL}.Fly"},
        }
        answer = client.call("GetInterfaceDescription", interface="io.other")
        assert answer["error"] == f"{SERVICE}.InterfaceNotFound"
        client.bytes(b'{"method":"io.other.Fly"}\0')
        assert client.receive()["parameters"] == {"interface": "io.other"}
        client.bytes(b'{"method":"Status"}\0')
        assert client.receive()["parameters"] == {"method": "Status"}


@pytest.mark.parametrize(("points", "names"), [(2001, NAMES[:1]), (2001, ["nobody"]), (1, ["nobody"])])
def test_an_overlong_trajectory_is_refused_as_the_contract_says(
    loop: StandIn, points: int, names: list[str]
) -> None:
    path = {"joint_names": names, "points": [{"positions": [0.0], "time_from_start": 0.5}] * points}
    expected = ["UNKNOWN_JOINT"] * (names == ["nobody"]) + ["TOO_MANY_POINTS"] * (points > 2000)
    with Raw(loop) as raw:
        refused = raw.call("SubmitTrajectory", trajectory=path)
        assert [each["code"] for each in refused["parameters"]["findings"]] == expected
        checked = raw.call("Check", trajectory=path)
        assert [each["code"] for each in checked["parameters"]["verdict"]["refusals"]] == expected
        assert "status" in raw.call("GetStatus")["parameters"]


@pytest.mark.parametrize(("name", "limit"), [("observe", 64 << 10), ("control", 4 << 20)])
def test_a_message_too_large_is_refused_and_the_connection_closed(
    loop: StandIn, name: str, limit: int
) -> None:
    with Raw(loop, name) as client:
        fitting = b'{"method":"org.varlink.service.GetInfo"' + b" " * (limit - 40) + b"}"
        assert len(fitting) == limit
        client.bytes(fitting + b"\0")
        assert client.receive()["parameters"]["vendor"] == "twind"
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            client.bytes(b"x" * (limit + 1))
        assert code(client.receive()) == "FRAME_TOO_LARGE"
        assert client.ended()


# --------------------------------------------------------------------------- many, slow and broken clients


def test_a_slow_subscriber_loses_the_oldest_telemetry_and_receives_the_count(tmp_path: Path) -> None:
    # A rate far above that of the loop: each tick is due, however early a busy machine makes it.
    loop = StandIn(tmp_path, given_briefing=msgspec.structs.replace(briefing(), rate_hz=1e6, binding=b""))
    with contextlib.closing(loop), Raw(loop) as client:
        assert "error" not in client.call("GetStatus")  # the front serves
        client.send("Monitor", parameters={"topics": ["state"], "rate": 1e6}, more=True)
        time.sleep(1.3)  # more than the kernel and the queue keep, less than the front's patience
        last = 0
        lost = 0
        gap = 0
        end = time.monotonic() + 5.0
        while not lost and time.monotonic() < end:
            message = client.receive()["parameters"]
            lost = message["dropped"]
            gap = message["sequence"] - last - 1
            last = message["sequence"]
    assert lost
    assert gap == lost


def test_a_reader_that_takes_nothing_is_closed_and_others_are_served(loop: SharedFront) -> None:
    with Raw(loop) as frozen, Raw(loop) as other:
        frozen.send("Monitor", parameters={"topics": ["state"], "rate": 100.0}, more=True)
        assert "error" not in other.call("GetStatus")
        end = time.monotonic() + 10.0
        while "SLOW_READER" not in loop.logged() and time.monotonic() < end:
            assert "error" not in other.call("GetStatus")
            time.sleep(0.05)
        assert "SLOW_READER" in loop.logged()
        assert frozen.ended()
        assert "error" not in other.call("GetStatus")


def test_when_all_places_are_taken_an_estop_still_gets_through(loop: StandIn) -> None:
    with contextlib.ExitStack() as stack:
        taken = [stack.enter_context(Raw(loop, "observe")) for _ in range(16)]
        for client in taken:
            assert "error" not in client.call("GetStatus")
        late = [stack.enter_context(Raw(loop, "observe")) for _ in range(6)]
        assert late[-1].call("GetStatus")["error"] == f"{CONTROL}.Busy"
        assert late[0].ended()  # the oldest of them made room
        assert "error" not in late[-1].call("EStop")
        loop.await_command(link.EStop)


def test_a_connection_closed_in_mid_message_affects_no_other_client(loop: StandIn) -> None:
    loop.answers[link.Arm] = lambda c: []
    for message in (
        b"",
        b"{",
        b'{"method":"io.twind.Control.Arm"}\0',
        b'{"method":"io.twind.Control.GetRobot"}\0' * 50,
    ):
        with Raw(loop) as client:
            client.bytes(message)
    with Raw(loop) as client:
        assert "error" not in client.call("GetStatus")


@pytest.mark.parametrize("reason", SCENES)
def test_every_reason_code_of_the_front_is_reached(loop: StandIn, reason: ReasonCode) -> None:
    assert reason.value in set(SCENES[reason](loop))


# --------------------------------------------------------------------------- a loop of one's own


@pytest.fixture
def own(tmp_path: Path) -> Iterator[StandIn]:
    stand_in = StandIn(tmp_path)
    yield stand_in
    stand_in.close()


def test_a_full_link_replies_busy_to_commands_and_delivers_stops_later(own: StandIn) -> None:
    with Raw(own) as client:
        assert "error" not in client.call("GetStatus")
        own.deaf = True
        time.sleep(0.05)
        busy = None
        flood = [Raw(own) for _ in range(3)]
        with contextlib.ExitStack() as stack:
            for one in flood:
                stack.enter_context(one)
            end = time.monotonic() + 5.0
            parameters = {"bus": "y" * 30000, "id": 1, "name": "x"}
            for one in flood:
                for _ in range(30):
                    one.send("ReadRegister", parameters=parameters, oneway=True)
            while busy is None and time.monotonic() < end:
                client.send("ReadRegister", parameters=parameters)
                client.socket.settimeout(0.5)
                with contextlib.suppress(TimeoutError):
                    busy = client.receive()
        assert busy is not None
        assert busy["error"] == f"{CONTROL}.Busy"
        assert "full" in busy["parameters"]["what"]
        client.socket.settimeout(5.0)
        client.send("EStop")
        own.deaf = False
        own.await_command(link.EStop)
        assert "error" not in client.receive()


def test_sigterm_and_sigint_leave_the_front_alone_and_the_loops_end_ends_it(own: StandIn) -> None:
    with Raw(own) as client:
        assert "error" not in client.call("GetStatus")
        own.front.terminate()
        own.front.send_signal(2)
        time.sleep(0.1)
        assert "error" not in client.call("GetStatus")
        assert own.heartbeats > 0
        assert own.close() == 0
        assert client.ended()
