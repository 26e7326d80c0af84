"""Situations in which the front process reports each reason code, by bytes on its sockets."""

import socket
from collections.abc import Callable, Iterable
from contextlib import suppress

from tests.support.loop_stand_in import NAMES, StandIn
from tests.support.raw_connection import Raw
from twind.robot.finding import ReasonCode

Told = Iterable[str]
Scene = Callable[[StandIn], Told]
SCENES: dict[ReasonCode, Scene] = {}


def leads_to(code: ReasonCode) -> Callable[[Scene], Scene]:
    def keep(scene: Scene) -> Scene:
        SCENES[code] = scene
        return scene

    return keep


def refusals(answer: dict) -> list[str]:
    return [finding["code"] for finding in answer["parameters"]["findings"]]


@leads_to(ReasonCode.FRAME_TOO_LARGE)
def a_message_is_too_large(loop: StandIn) -> Told:
    with Raw(loop, "observe") as client:
        with suppress(BrokenPipeError, ConnectionResetError):
            client.bytes(b"x" * ((64 << 10) + 1))
        return refusals(client.receive())


@leads_to(ReasonCode.FRAME_INCOMPLETE)
def a_message_has_no_terminator(loop: StandIn) -> Told:
    with Raw(loop, "observe") as client:
        client.bytes(b'{"method":"io.twind.Control.GetStatus"}')
        client.socket.shutdown(socket.SHUT_WR)
        return refusals(client.receive())


@leads_to(ReasonCode.BAD_JSON)
def a_key_stands_twice(loop: StandIn) -> Told:
    with Raw(loop) as client:
        client.bytes(b'{"method":"a","method":"b"}\0')
        return refusals(client.receive())


@leads_to(ReasonCode.RATE_LIMIT)
def too_many_trajectories_come(loop: StandIn) -> Told:
    path = {"joint_names": [NAMES[0]], "points": []}
    with Raw(loop) as client:
        answers = [client.call("SubmitTrajectory", trajectory=path) for _ in range(25)]
    return [code for answer in answers for code in refusals(answer)]


@leads_to(ReasonCode.AUTH_ROLE)
def an_observer_disarms(loop: StandIn) -> Told:
    with Raw(loop, "observe") as watcher, Raw(loop, "observe") as client:
        watcher.send("Monitor", parameters={"topics": ["verdicts"]}, more=True)
        client.call("GetStatus")
        assert client.call("Disarm")["error"].endswith("NotAllowed")
        return [finding["code"] for finding in watcher.receive()["parameters"]["verdict"]["refusals"]]
