"""Messages to subscribers, as bytes of a real front process; the loop behind it is a stand-in."""

import os
import time
from typing import Any

import pytest

from tests.support.loop_stand_in import NAMES, StandIn
from tests.support.raw_connection import CONTRACT, Raw
from twind import link
from twind.protocol import CONTROL, SERVICE

HOLDER = f"uid {os.getuid()}, pid {os.getpid()}"


def watching(loop: StandIn, *topics: str) -> Raw:
    """A connection that has subscribed: the front serves by then."""
    watcher = Raw(loop, "observe")
    assert "error" not in watcher.call("GetStatus")
    watcher.send("Monitor", parameters={"topics": list(topics)}, more=True)
    time.sleep(0.05)
    return watcher


def next_report(watcher: Raw) -> dict[str, Any]:
    """The next message; it has what the interface says."""
    message: dict[str, Any] = watcher.receive()["parameters"]
    CONTRACT.methods["Monitor"].results.check(message, "")
    return message


# ------------------------------------------------------------------------------------- verdicts


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"{", "BAD_JSON"),
        (b'{"method": 1}', "BAD_SCHEMA"),
        (b"\x20" * (4 << 20) + b" ", "FRAME_TOO_LARGE"),
        (
            b'{"method":"io.twind.Control.Setpoint","parameters":{"joint_names":["nose"],"positions":[0]}}',
            "UNKNOWN_JOINT",
        ),
        (
            b'{"method":"io.twind.Control.SubmitTrajectory","parameters":{"trajectory":'
            b'{"joint_names":[],"points":[]}}}',
            "EMPTY",
        ),
    ],
    ids=["no JSON", "bad schema", "too large", "setpoint", "trajectory"],
)
def test_a_refusal_by_the_front_process_is_published_as_a_verdict(
    loop: StandIn, data: bytes, code: str
) -> None:
    with watching(loop, "verdicts") as watcher, Raw(loop) as client:
        client.bytes(data + b"\0")
        assert client.receive()["error"] == f"{CONTROL}.Refused"
        message = next_report(watcher)
    assert code in [finding["code"] for finding in message["verdict"]["refusals"]]
    assert (message["topic"], message["sequence"], message["id"]) == ("verdicts", 0, None)


def test_marks_that_come_too_fast_are_refused_and_trajectories_are_counted_beside_them(loop: StandIn) -> None:
    path = {"joint_names": [NAMES[0]], "points": [{"positions": [0.0], "time_from_start": 1.0}]}
    with Raw(loop) as client:
        answers = [client.call("Mark", kind="note", text=str(number)) for number in range(24)]
        assert ["error" in answer for answer in answers] == [False] * 20 + [True] * 4
        (finding,) = answers[-1]["parameters"]["findings"]
        assert (finding["code"], finding["bound"]) == ("RATE_LIMIT", 20)
        assert "error" not in client.call("Check", trajectory=path)
    assert len([command for command in loop.commands if isinstance(command, link.Mark)]) == 20


# ------------------------------------------------------------------------------------- trajectories


def judging(loop: StandIn, refusals: list[Any], changes: list[Any]) -> None:
    """The stand-in's gate says this of the next trajectory."""

    def answer(command: link.Command) -> list[link.Reply]:
        assert isinstance(command, link.Submit)
        verdict = {"refusals": refusals, "warnings": [], "changes": changes}
        loop.send(link.VerdictReport(time=5.0, sequence=9, id=command.id, verdict=verdict, lead=0.25))
        given = {"id": command.id, "phase": "accepted", "progress": 0.0}
        return [link.Reply(ticket=command.ticket, parameters=given)]

    loop.answers[link.Submit] = answer


PATH = {
    "joint_names": [NAMES[3], NAMES[0]],
    "points": [{"positions": [0.3, 0.1], "velocities": [0.0, 0.0], "time_from_start": 1.0}],
    "policy": "reject",
    "start_in": 2.0,
    "tolerances": [{"joint": NAMES[3], "path": 0.1}],
}


def test_an_accepted_trajectory_is_published_as_it_is_followed(loop: StandIn) -> None:
    judging(loop, [], [{"code": "RETIMED", "joint": None, "value": 1.5, "bound": 1.0, "message": ""}])
    with watching(loop, "verdicts", "trajectories") as watcher, Raw(loop) as client:
        name = client.call("SubmitTrajectory", trajectory=PATH)["parameters"]["id"]
        verdict = next_report(watcher)
        message = next_report(watcher)
    assert (verdict["topic"], verdict["id"], verdict["sequence"]) == ("verdicts", name, 9)
    assert (message["topic"], message["time"], message["sequence"]) == ("trajectories", 5.0, 9)
    accepted = message["accepted"]
    assert (accepted["id"], accepted["holder"]) == (name, HOLDER)
    assert accepted["trajectory"]["joint_names"] == [NAMES[0], NAMES[3]]
    assert accepted["trajectory"]["points"] == [
        {"positions": [0.1, 0.3], "velocities": [0.0, 0.0], "time_from_start": 1.75}
    ]
    assert accepted["trajectory"]["start_in"] == 2.0
    assert accepted["trajectory"]["tolerances"] == PATH["tolerances"]
    CONTRACT.methods["Check"].parameters.check(
        {"trajectory": accepted["trajectory"]}, ""
    )  # can be sent again


# ------------------------------------------------------------------------------------- histograms


def test_histograms_come_with_the_first_message_and_once_a_second(loop: StandIn) -> None:
    with watching(loop, "latency") as watcher:
        hops = [next_report(watcher)["latency"][0] for _ in range(22)]
    whole = [place for place, hop in enumerate(hops) if hop["histogram"] is not None]
    assert whole[0] == 0
    assert len(whole) in (2, 3)
    first = hops[0]
    assert [bucket["upper_ms"] for bucket in first["histogram"]] == [0.05, None]
    assert first["histogram_sum_ms"] == 7.5
    assert hops[1]["histogram_sum_ms"] is None


def test_a_slow_subscriber_rate_still_receives_histograms_each_time(loop: StandIn) -> None:
    with Raw(loop, "observe") as watcher:
        watcher.send("Monitor", parameters={"topics": ["latency"], "rate": 0.9}, more=True)
        assert all(next_report(watcher)["latency"][0]["histogram"] for _ in range(2))


def test_lateness_is_in_every_status(loop: StandIn) -> None:
    with Raw(loop, "observe") as client:
        for _ in range(3):
            told_by = client.call("GetStatus")["parameters"]["status"]["loop"]
            assert [bucket["upper_ms"] for bucket in told_by["lateness"]] == [0.05, None]
            assert told_by["lateness_sum_ms"] == 7.5
            time.sleep(0.1)


# ------------------------------------------------------------------------------------- marks


def test_a_mark_is_forwarded_unchanged_and_shown_by_its_event(loop: StandIn) -> None:
    with watching(loop, "events") as watcher, Raw(loop) as client:
        assert "error" not in client.call("Mark", kind="end", task="pick", success=True, text=None)
        mark = loop.await_command(link.Mark)
        assert isinstance(mark, link.Mark)
        assert mark.annotation == link.Annotation("end", task="pick", success=True)
        loop.send(
            link.Event(
                time=1.0,
                sequence=3,
                level="info",
                code="EPISODE_END",
                message="m",
                annotation=mark.annotation,
                holder="x",
            )
        )
        event = next_report(watcher)["event"]
    assert event["annotation"] == {"kind": "end", "task": "pick", "success": True, "text": None}


def test_a_mark_of_bad_form_never_reaches_the_loop(loop: StandIn) -> None:
    with Raw(loop) as client:
        unknown = client.call("Mark", kind="middle")
        assert (unknown["error"], unknown["parameters"]["known"]) == (
            f"{CONTROL}.NotFound",
            ["begin", "end", "note"],
        )
        missing = client.call("Mark", kind="begin")
        assert (missing["error"], missing["parameters"]["parameter"]) == (
            f"{SERVICE}.InvalidParameter",
            "task",
        )
    assert not [command for command in loop.commands if isinstance(command, link.Mark)]


# ------------------------------------------------------------------------------------- when it was called


def test_a_command_carries_its_time_of_reception(loop: StandIn) -> None:
    with Raw(loop) as client:
        before = time.monotonic()
        client.call("Cancel")
        after = time.monotonic()
        command = loop.await_command(link.Cancel)
    assert isinstance(command, link.Cancel)
    assert before <= command.received <= after
