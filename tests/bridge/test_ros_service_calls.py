"""Stops, modes and queries from ROS: a stop waits for no other call, whatever its bytes are."""

import json
import threading
import time
from collections.abc import Mapping
from typing import Any

import pytest

from tests.support.processes import until
from tests.support.scripted_line import ScriptedDaemon
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
    RosTopic,
)
from twind.bridge.ros.ros_service_calls import MODE_PACE, STOP_PACE, STOPPING, RosServiceCalls, denied
from twind.ros import STRING, encode


def text(words: str) -> bytes:
    return encode(STRING, {"data": words})


class Desk:
    """Calls, and the daemon that they go to."""

    def __init__(self) -> None:
        self.daemon = ScriptedDaemon()
        self.stops = 0
        self.results: list[dict[str, Any]] = []
        self.lines: list[str] = []
        self.broken = False  # nothing can be said
        self.closed: dict[bool, str] = {}  # why no stop (True), no mode (False) is taken
        client = self.daemon.client
        self.calls = RosServiceCalls(
            client, client, self.stopping, json.dumps, self.why, self.say, self.lines.append
        )
        self.calls.start()

    def why(self, stop: bool) -> str:
        return self.closed.get(stop, "")

    def stopping(self) -> None:
        """It is told before the daemon is asked."""
        assert len(self.daemon.named("Cancel") + self.daemon.named("EStop")) == self.stops
        self.stops += 1

    def say(self, result: Mapping[str, Any]) -> None:
        if self.broken:
            raise BrokenPipeError("nobody reads it")
        self.results.append(dict(result))

    def receive(self, topic: RosTopic, data: bytes) -> dict[str, Any]:
        """Send a message; return its result."""
        before = len(self.results)
        self.calls.on_message(topic, data)
        until(lambda: len(self.results) > before, 10.0, "an outcome")
        return self.results[before]


@pytest.fixture
def desk() -> Desk:
    return Desk()


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
    assert desk.receive(E_STOP, data)["phase"] == "done"
    (asked,) = desk.daemon.named("EStop")
    assert asked["level"] == level and asked["reason"] == "requested over ROS"
    assert desk.stops == 1


@pytest.mark.parametrize("data", [text(""), text("now"), b"\0"])
def test_any_stop_message_triggers_a_stop(desk: Desk, data: bytes) -> None:
    result = desk.receive(STOP, data)
    assert (result["phase"], result["message"]) == ("done", STOPPING)  # the motion's state, not the bus's
    assert desk.daemon.named("Cancel") == [{}] and desk.stops == 1


def test_a_valid_mode_is_requested_and_an_unknown_mode_is_reported(desk: Desk) -> None:
    assert desk.receive(SET_MODE, text("mirror")) == {
        "topic": "/bridge/set_mode_cmd",
        "asked": "mirror",
        "phase": "done",
        "message": "mirror",
    }
    known = {"what": "mode", "name": "warp", "known": ["sim", "mirror", "live"]}
    desk.daemon.refuse["SetMode"] = ("NotFound", known)
    refused = desk.receive(SET_MODE, text("warp"))
    assert refused["phase"] == "refused" and "known: sim, mirror, live" in refused["message"]
    assert desk.receive(SET_MODE, b"\0\1\0\0")["message"].startswith("malformed")
    assert len(desk.daemon.named("SetMode")) == 2 and desk.stops == 0


@pytest.mark.parametrize(("topic", "words"), [(SET_MODE, "live"), (E_STOP, "settle")])
def test_a_cut_waits_neither_for_a_mode_change_nor_for_a_settling_that_hangs(
    desk: Desk, topic: RosTopic, words: str
) -> None:
    hung = threading.Event()
    go_on = threading.Event()

    def hang(method: str) -> None:
        if not hung.is_set():
            hung.set()
            go_on.wait(20.0)

    desk.daemon.meanwhile = hang
    desk.calls.on_message(topic, text(words))
    assert hung.wait(10.0)
    try:
        result = desk.receive(E_STOP, text("cut"))
    finally:
        go_on.set()
    assert (result["asked"], result["phase"]) == ("cut", "done")
    until(lambda: len(desk.results) == 2, 10.0, "both outcomes")


def test_a_flood_of_modes_ends_with_the_last_that_was_asked_for(desk: Desk) -> None:
    for number in range(300):
        desk.calls.on_message(SET_MODE, text(("sim", "mirror", "live")[number % 3]))
    desk.calls.on_message(SET_MODE, text("mirror"))
    until(lambda: {"mode": "mirror"} in desk.daemon.named("SetMode")[1:], 10.0, "the last")
    until(lambda: len(desk.results) == len(desk.daemon.named("SetMode")), 10.0, "all told")
    assert desk.daemon.named("SetMode")[-1] == {"mode": "mirror"}


@pytest.mark.parametrize(
    ("topic", "texts", "pace"),
    [
        (SET_MODE, (text("sim"), b"\0"), MODE_PACE),
        (STOP, (b"",), STOP_PACE),
    ],
)
def test_a_flood_has_a_call_and_a_result_now_and_then(
    desk: Desk, topic: RosTopic, texts: tuple[bytes, ...], pace: float
) -> None:
    begun = time.monotonic()
    while time.monotonic() < begun + 1.0:
        for each in texts:
            desk.calls.on_message(topic, each)
        time.sleep(0.001)
    most = 1 + (time.monotonic() - begun) / pace
    assert 0 < len(desk.results) <= most and len(desk.daemon.calls) <= most


def test_a_stop_whose_outcome_cannot_be_published_does_not_prevent_the_next(desk: Desk) -> None:
    desk.broken = True
    for count in (1, 2):
        desk.calls.on_message(E_STOP, text("cut"))
        until(lambda: len(desk.daemon.named("EStop")) == count, 10.0, f"e-stop {count}")  # noqa: B023
        until(lambda: len(desk.lines) == count, 10.0, "a line")  # noqa: B023
    assert "BrokenPipeError" in desk.lines[0]


def test_an_e_stop_takes_the_other_way_where_the_one_fails(desk: Desk) -> None:
    full = ScriptedDaemon()
    full.refuse["EStop"] = ("Busy", {"what": "all places are taken"})
    calls = RosServiceCalls(
        desk.daemon.client, full.client, desk.stopping, str, desk.why, desk.results.append, desk.lines.append
    )
    assert calls.e_stop("cut") == (True, "estop")
    assert [each["level"] for each in desk.daemon.named("EStop")] == ["cut"]


def test_a_missing_permission_is_detected_by_a_call_without_effect(desk: Desk) -> None:
    assert denied(desk.daemon.client) == ""
    desk.daemon.refuse["ReleaseLease"] = ("NotAllowed", {"method": "ReleaseLease", "role": "observer"})
    assert "not for the role observer" in str(denied(desk.daemon.client))
    desk.daemon.refuse["ReleaseLease"] = ("Busy", {"what": "all places"})
    assert denied(desk.daemon.client) is None
    desk.daemon.absent = True
    assert denied(desk.daemon.client) is None


def test_a_status_is_that_of_the_time_when_it_was_asked_for(desk: Desk) -> None:
    modes = iter(("sim", "mirror"))
    answer = desk.daemon.answer

    def answered(message: bytes) -> bytes:
        told = answer(message)
        status = {"parameters": {"status": {"mode": next(modes)}}}
        return json.dumps(status).encode() if b"GetStatus" in message else told

    desk.daemon.answer = answered  # type: ignore[method-assign]
    assert desk.calls.handle_request(GET_STATUS, None) == (True, '{"mode": "sim"}')
    assert desk.calls.handle_request(GET_STATUS, None) == (True, '{"mode": "mirror"}')
    desk.daemon.absent = True
    assert desk.calls.handle_request(GET_STATUS, None) == (True, '"nobody listens"')


def test_a_closed_service_replies_with_the_reason_and_an_e_stop_is_always_served(desk: Desk) -> None:
    desk.closed = {True: "it only looks", False: "another bridge"}
    told = desk.receive(STOP, b"")
    assert (told["phase"], told["message"]) == ("refused", "it only looks")
    told = desk.receive(SET_MODE, text("live"))
    assert (told["phase"], told["message"]) == ("refused", "another bridge")
    assert desk.calls.handle_request(SET_LIVE, True) == (False, "another bridge")
    assert desk.stops == 0 and not desk.daemon.calls
    assert desk.receive(E_STOP, b"")["phase"] == "done" and desk.calls.handle_request(TO_E_STOP, None)[0]


def test_every_service_is_answered(desk: Desk) -> None:
    answer = desk.daemon.answer
    status = b'{"parameters": {"status": {"mode": "sim"}}}'
    desk.daemon.answer = lambda message: status if b"GetStatus" in message else answer(message)  # type: ignore[method-assign]
    asked = {
        service: desk.calls.handle_request(service, None) for service in SERVICES if service is not SET_LIVE
    }
    assert all(done for done, _ in asked.values())
    assert asked[GET_STATUS][1] == '{"mode": "sim"}' and asked[TO_E_STOP][1] == "estop"
    for mode, service in TO_MODE.items():
        assert asked[service] == (True, mode)
    assert desk.calls.handle_request(SET_LIVE, True) == (True, "live")
    assert desk.calls.handle_request(SET_LIVE, False) == (True, "mirror")


def test_a_failed_service_call_replies_with_the_cause(desk: Desk) -> None:
    desk.daemon.absent = True
    assert desk.calls.handle_request(TO_STOP, None) == (False, "nobody listens")
    assert desk.calls.handle_request(GET_STATUS, None)[0]
