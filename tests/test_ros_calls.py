"""Stops, modes and questions from ROS: a stop waits for nobody, and no word of it is needed."""

import threading
from typing import Any

import pytest
from processes import until
from told_line import ToldDaemon

from twind.bridge.ros.calls import Calls
from twind.bridge.ros.endpoints import (
    E_STOP,
    GET_STATUS,
    SERVICES,
    SET_LIVE,
    SET_MODE,
    STOP,
    TO_E_STOP,
    TO_MODE,
    TO_STOP,
    Topic,
)
from twind.ros import STRING, encode


def text(words: str) -> bytes:
    return encode(STRING, {"data": words})


class Desk:
    """Calls, and the daemon that they go to."""

    def __init__(self) -> None:
        self.daemon, self.stops = ToldDaemon(), 0
        self.results: list[dict[str, Any]] = []
        client = self.daemon.client
        self.calls = Calls(client, client, self.stopping, lambda: '{"mode": "sim"}', self.results.append)
        self.calls.start()

    def stopping(self) -> None:
        """It is told before the daemon is asked."""
        assert len(self.daemon.named("Cancel") + self.daemon.named("EStop")) == self.stops
        self.stops += 1

    def heard(self, topic: Topic, data: bytes) -> dict[str, Any]:
        """What became of it."""
        before = len(self.results)
        self.calls.heard(topic, data)
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
def test_whatever_comes_as_an_e_stop_is_one(desk: Desk, data: bytes, level: str) -> None:
    assert desk.heard(E_STOP, data)["phase"] == "done"
    (asked,) = desk.daemon.named("EStop")
    assert asked["level"] == level and asked["reason"] == "asked for over ROS"
    assert desk.stops == 1


@pytest.mark.parametrize("data", [text(""), text("now"), b"\0"])
def test_whatever_comes_as_a_stop_is_one(desk: Desk, data: bytes) -> None:
    assert desk.heard(STOP, data)["phase"] == "done"
    assert desk.daemon.named("Cancel") == [{}] and desk.stops == 1


def test_a_mode_is_asked_for_and_what_is_none_is_told(desk: Desk) -> None:
    assert desk.heard(SET_MODE, text("mirror")) == {
        "topic": "/bridge/set_mode_cmd",
        "asked": "mirror",
        "phase": "done",
        "message": "mirror",
    }
    known = {"what": "mode", "name": "warp", "known": ["sim", "mirror", "live"]}
    desk.daemon.refuse["SetMode"] = ("NotFound", known)
    refused = desk.heard(SET_MODE, text("warp"))
    assert refused["phase"] == "refused" and "known: sim, mirror, live" in refused["message"]
    assert desk.heard(SET_MODE, b"\0\1\0\0")["message"].startswith("malformed")
    assert len(desk.daemon.named("SetMode")) == 2 and desk.stops == 0


def test_a_stop_does_not_wait_for_a_mode_that_hangs(desk: Desk) -> None:
    hung, go_on = threading.Event(), threading.Event()

    def hanging(method: str) -> None:
        if method == "SetMode":
            hung.set()
            go_on.wait(20.0)

    desk.daemon.meanwhile = hanging
    desk.calls.heard(SET_MODE, text("live"))
    assert hung.wait(10.0)
    assert desk.heard(E_STOP, text(""))["phase"] == "done"
    go_on.set()
    until(lambda: len(desk.results) == 2, 10.0, "both outcomes")


def test_a_flood_of_modes_ends_with_the_last_that_was_asked_for(desk: Desk) -> None:
    for number in range(300):
        desk.calls.heard(SET_MODE, text(("sim", "mirror", "live")[number % 3]))
    desk.calls.heard(SET_MODE, text("mirror"))
    until(lambda: not any(errand._what for errand in desk.calls._errands.values()), 10.0, "all done")
    until(lambda: len(desk.results) == len(desk.daemon.named("SetMode")), 10.0, "all told")
    assert desk.daemon.named("SetMode")[-1] == {"mode": "mirror"}


def test_every_service_is_answered(desk: Desk) -> None:
    asked = {service: desk.calls.asked(service, None) for service in SERVICES if service is not SET_LIVE}
    assert all(done for done, _ in asked.values())
    assert asked[GET_STATUS][1] == '{"mode": "sim"}' and asked[TO_E_STOP][1] == "estop"
    for mode, service in TO_MODE.items():
        assert asked[service] == (True, mode)
    assert desk.calls.asked(SET_LIVE, True) == (True, "live")
    assert desk.calls.asked(SET_LIVE, False) == (True, "mirror")


def test_a_service_that_fails_says_why(desk: Desk) -> None:
    desk.daemon.absent = True
    assert desk.calls.asked(TO_STOP, None) == (False, "nobody listens")
    assert desk.calls.asked(GET_STATUS, None)[0]
