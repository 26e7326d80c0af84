"""Commands through a real front process: what reaches the loop, and what comes back."""

import os
import time
from typing import Any

import pytest

from tests.support.loop_stand_in import NAMES, StandIn
from tests.support.raw_connection import CONTRACT, Raw, code
from twind import link
from twind.client import CallError, Client


# First: the trajectories of other tests would count too.
def test_more_than_twenty_trajectories_a_second_are_refused(loop: StandIn) -> None:
    path = {"joint_names": [NAMES[0]], "points": [{"positions": [0.0], "time_from_start": 1.0}]}
    loop.await_lookahead()  # the first would wait for it, and the others come a second later
    with Raw(loop) as client:
        answers = [client.call("Check", trajectory=path) for _ in range(25)]
        assert ["error" in answer for answer in answers] == [False] * 20 + [True] * 5
        assert code(answers[-1]) == "RATE_LIMIT"
        time.sleep(1.05)
        assert "error" not in client.call("Check", trajectory=path)


def test_a_command_carries_who_asked_and_its_answer_comes_back(loop: StandIn) -> None:
    loop.answers[link.SetMode] = lambda c: [link.Reply(ticket=c.ticket, parameters={"mode": "sim"})]
    with Raw(loop) as client:
        assert client.call("SetMode", mode="sim") == {"parameters": {"mode": "sim"}}
        command = loop.await_command(link.SetMode)
        assert isinstance(command, link.SetMode)
        assert (command.uid, command.holder) == (os.getuid(), f"uid {os.getuid()}, pid {os.getpid()}")
        assert command.client > 0
    loop.await_message(lambda message: message == link.ConnectionClosed(client=command.client))


def test_an_error_of_the_loop_comes_back_with_joints_named(loop: StandIn) -> None:
    finding = {"code": "POS_LIMIT", "joint": 1, "point": 0, "value": 2.0, "bound": 1.0, "message": ""}
    loop.answers[link.Arm] = lambda c: [
        link.Reply(ticket=c.ticket, error="Refused", parameters={"findings": [finding]})
    ]
    with Raw(loop) as client:
        answer = client.call("Arm")
    CONTRACT.errors["Refused"].check(answer["parameters"], "")
    assert (
        answer["parameters"]["findings"][0]["message"] == f"{NAMES[1]}, point 0: position 2 rad, bound 1 rad"
    )


def test_a_trajectory_travels_as_arrays_and_its_progress_comes_back(loop: StandIn) -> None:
    def run(command: link.Command) -> list[link.Reply]:
        assert isinstance(command, link.Submit)
        steps = [("accepted", 0.0, True), ("running", 0.5, True), ("succeeded", 1.0, False)]
        return [
            link.Reply(
                ticket=command.ticket,
                continues=goes_on,
                parameters={"id": command.id, "phase": phase, "progress": progress},
            )
            for phase, progress, goes_on in steps
        ]

    loop.answers[link.Submit] = run
    path = {"joint_names": [NAMES[3], NAMES[0]], "points": [{"positions": [0.3, 1], "time_from_start": 1.0}]}
    with Raw(loop) as client:
        client.send("SubmitTrajectory", parameters={"trajectory": path}, more=True)
        answers = [client.receive() for _ in range(3)]
    assert [a["parameters"]["phase"] for a in answers] == ["accepted", "running", "succeeded"]
    assert [a.get("continues") for a in answers] == [True, True, None]
    command = loop.await_command(link.Submit)
    assert isinstance(command, link.Submit)
    there = link.unpack_path(loop.paths[0], command, len(NAMES))
    assert (there.position[0, 3], there.position[0, 0]) == (0.3, 1.0)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"joint_names": [], "positions": []}, "NO_JOINTS"),
        ({"joint_names": ["nose"], "positions": [0.0]}, "UNKNOWN_JOINT"),
        ({"joint_names": ["joint_1", "joint_1"], "positions": [0.0, 0.0]}, "DUP_JOINT"),
        ({"joint_names": ["joint_1"], "positions": [0.0, 0.0]}, "BAD_SHAPE"),
        ({"joint_names": ["joint_1"], "positions": [0.0], "velocities": []}, "BAD_SHAPE"),
    ],
)
def test_a_setpoint_of_bad_form_is_refused(loop: StandIn, parameters: dict[str, Any], expected: str) -> None:
    with Raw(loop) as client:
        assert code(client.call("Setpoint", **parameters)) == expected


def test_find_stop_reaches_the_loop_by_joint_index_and_its_phases_return(loop: StandIn) -> None:
    def answer(command: link.Command) -> list[link.Reply]:
        told = [
            {"phase": "approaching", "progress": 0.5},
            {"phase": "found", "progress": 1.0, "ticks": [1, 2]},
        ]
        return [
            link.Reply(ticket=command.ticket, parameters=each, continues=each is not told[-1])
            for each in told
        ]

    loop.answers[link.FindStop] = answer
    with Client(str(loop.directory)) as client:
        answers = list(client.stream("FindStop", joint=NAMES[1], side="upper", speed=0.1, times=4))
    command = loop.await_command(link.FindStop)
    assert [each["phase"] for each in answers] == ["approaching", "found"]
    assert answers[-1]["ticks"] == [1, 2]
    assert isinstance(command, link.FindStop)
    assert (command.joint, command.side, command.speed, command.times) == (1, "upper", 0.1, 4)
    assert command.current_share is None and command.more


def test_stated_angles_reach_the_loop_by_joint_index_and_bad_ones_do_not(loop: StandIn) -> None:
    loop.answers[link.LocateJoints] = lambda command: [
        link.Reply(ticket=command.ticket, parameters={"positions": [0.5]})
    ]
    with Client(str(loop.directory)) as client:
        for names, angles in (
            (["nobody"], [0.5]),
            ([NAMES[1]], [0.5, 0.6]),
            ([], []),
            ([NAMES[1]] * 2, [0.5] * 2),
        ):
            with pytest.raises(CallError):
                client.call("LocateJoints", joint_names=names, positions=angles)
        answer = client.call("LocateJoints", joint_names=[NAMES[1]], positions=[0.5])
    command = loop.await_command(link.LocateJoints)
    assert isinstance(command, link.LocateJoints)
    assert (list(command.joints), list(command.positions), answer) == ([1], [0.5], {"positions": [0.5]})


@pytest.mark.parametrize(
    ("how", "what"),
    [({"joint": "nobody", "side": "lower"}, "joint"), ({"joint": NAMES[0], "side": "left"}, "side")],
)
def test_an_unknown_joint_or_side_is_reported_with_the_valid_ones(
    loop: StandIn,
    how: dict[str, str],
    what: str,
) -> None:
    with Client(str(loop.directory)) as client, pytest.raises(CallError) as told:
        client.call("FindStop", **how)
    assert told.value.name == "NotFound" and told.value.parameters["what"] == what
    assert len(told.value.parameters["known"]) == (len(NAMES) if what == "joint" else 2)
    assert not [command for command in loop.commands if isinstance(command, link.FindStop)]
