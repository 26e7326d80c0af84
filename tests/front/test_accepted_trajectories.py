"""Accepted trajectories: the published path equals the one that the loop follows."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import Rig
from twind import link
from twind.front.accepted_trajectories import WAITING, AcceptedTrajectory, PendingVerdict, strip_points
from twind.front.client_calls import Caller, ClientCall, ConnectionCalls
from twind.front.interface_methods import METHODS
from twind.front.joint_naming import JointNames
from twind.protocol import CONTROL
from twind.robot.finding import ReasonCode, Verdict
from twind.robot.splines import interpolate
from twind.robot.trajectory import Trajectory

JOINT = "l_elbow"


# ------------------------------------------------------------------------------------- from the loop


def sent(rig: Rig, path: Trajectory, **asked: Any) -> tuple[PendingVerdict, list[link.VerdictReport]]:
    """A path on its way through a real loop, and the verdicts that came of it."""
    waiting = PendingVerdict()
    ticket = rig.submit(path, **asked)
    waiting.wait(AcceptedTrajectory(f"t{ticket}", "uid 1, pid 2", path, strip_points(asked)))
    rig.news.clear()
    rig.ticks(8)
    return waiting, [news for news in rig.news if isinstance(news, link.VerdictReport)]


def moved(rig: Rig, way: list[float], time: list[float], velocity: list[float] | None = None) -> Trajectory:
    here = float(rig.loop.executor.reference.position[rig.names.index(JOINT)])
    path = rig.path(JOINT, [here - each for each in way], time)
    if velocity is None:
        return path
    speed = np.zeros_like(path.position)
    speed[:, rig.names.index(JOINT)] = velocity
    return replace(path, velocity=speed)


@pytest.mark.parametrize(
    ("way", "time", "velocity", "asked", "later"),
    [
        ([0.1, 0.3], [0.04, 0.06], [-0.5, 0.0], {"policy": "retime"}, False),
        ([0.1], [1.0], None, {}, False),
        ([0.3], [0.05], [0.0], {"policy": "retime"}, False),
        ([0.1], [1.0], [-0.2], {"append_stop": True}, False),
        ([0.3], [0.05], [-1.0], {"policy": "retime", "append_stop": True}, False),
        ([0.01, 0.1], [0.0, 1.0], [0.0, 0.0], {}, True),
        ([0.01, 0.1], [0.0, 1.0], [0.0, 0.0], {"start_in": 0.03}, True),
    ],
)
def test_the_published_trajectory_equals_the_one_the_loop_follows(
    armed: Rig, way: list[float], time: list[float], velocity: list[float] | None, asked: Any, later: bool
) -> None:
    path = moved(armed, way, time, velocity)
    begin = armed.loop.executor.reference
    waiting, (moment,) = sent(armed, path, **asked)
    accepted = waiting.resolve(moment)
    assert accepted is not None
    (layer,) = armed.loop.executor.layers
    assert layer.goal.id == accepted.id
    told = interpolate(accepted.path, begin)
    assert np.isfinite(told.sample(0.0).position[armed.names.index(JOINT)])
    assert told.duration == pytest.approx(layer.curve.duration, abs=1e-12)
    for time in np.linspace(0.0, layer.curve.duration, 50):
        for column in ("position", "velocity", "acceleration"):
            here, there = (getattr(curve.sample(float(time)), column) for curve in (told, layer.curve))
            assert here == pytest.approx(there, rel=1e-9, abs=1e-9, nan_ok=True)
    assert (moment.lead > 0.0) == later
    assert waiting.resolve(moment) is None  # each once


def test_a_refused_trajectory_is_published_as_a_verdict_only(armed: Rig) -> None:
    waiting, (moment,) = sent(armed, moved(armed, [9.0], [1.0]))
    assert moment.verdict["refusals"]
    assert waiting.resolve(moment) is None


def test_a_trajectory_that_expires_before_it_is_followed_has_one_refusing_verdict(armed: Rig) -> None:
    old = armed.clock.now() - 0.6
    waiting, (moment,) = sent(armed, moved(armed, [0.1], [1.0]), front_checked=old)
    assert [finding["code"] for finding in moment.verdict["refusals"]] == [ReasonCode.CMD_EXPIRED]
    assert waiting.resolve(moment) is None


def test_a_trajectory_refused_before_the_gate_has_a_verdict_too(armed: Rig) -> None:
    armed.submit(moved(armed, [0.1], [1.0]), start_in=0.5)
    _, moments = sent(armed, moved(armed, [0.1], [1.0]), start_in=0.6)
    assert [len(moment.verdict["refusals"]) for moment in moments][-1] == 1
    assert moments[-1].verdict["refusals"][0]["code"] == ReasonCode.BUSY
    (event,) = [event for event in armed.events("BUSY") if event.message.startswith("refused")]
    assert event.level == "warning"


# ------------------------------------------------------------------------------------- as it is told


def test_a_published_trajectory_names_its_joints_in_robot_order() -> None:
    rows = np.array([[0.1, np.nan, 0.3], [0.2, np.nan, 0.4]])
    path = Trajectory(np.array([0.5, 1.0]), rows, np.array([True, False, True]), rows * 0.0)
    asked = {"start_in": 2.0, "policy": "retime", "append_stop": True, "joint_names": ["ankle", "hip"]}
    told = AcceptedTrajectory("4f", "uid 1, pid 2", path, strip_points(asked)).plain(
        JointNames(["hip", "knee", "ankle"])
    )
    assert (told["id"], told["holder"]) == ("4f", "uid 1, pid 2")
    assert told["trajectory"] == {
        "joint_names": ["hip", "ankle"],
        "points": [
            {"time_from_start": 0.5, "positions": [0.1, 0.3], "velocities": [0.0, 0.0]},
            {"time_from_start": 1.0, "positions": [0.2, 0.4], "velocities": [0.0, 0.0]},
        ],
        "start_in": 2.0,
        "goal_time": None,
        "tolerances": None,
    }


def test_the_oldest_trajectories_without_a_verdict_are_dropped() -> None:
    waiting = PendingVerdict()
    path = Trajectory(np.array([1.0]), np.zeros((1, 1)), np.array([True]))
    for number in range(WAITING + 1):
        waiting.wait(AcceptedTrajectory(str(number), "", path, {}))
    verdicts = [
        waiting.resolve(link.VerdictReport(time=0.0, sequence=1, id=str(number), verdict={})) is not None
        for number in range(WAITING + 1)
    ]
    assert verdicts == [False, *[True] * WAITING]


# ------------------------------------------------------------------------------------- on its way to the loop


def submitting(method: str, *, room: bool) -> PendingVerdict:
    """A call, judged by the front, of which the link takes the command while it has `room`."""
    send: list[Callable[[Verdict, float], None]] = []
    front: Any = SimpleNamespace(
        now=lambda: 1.0,
        in_time=lambda *_: True,
        world=SimpleNamespace(
            names=JointNames(["hip"]), briefing=SimpleNamespace(description={"gate": {}}, generation=1)
        ),
        foreseen=SimpleNamespace(judge=lambda job: send.append(job.forward)),
        tickets=SimpleNamespace(open=lambda *_: 1, close=lambda _: None),
        link=SimpleNamespace(send=lambda *_: room),
        submitted=PendingVerdict(),
    )
    point = {"positions": [0.1], "time_from_start": 1.0}
    given = {"trajectory": {"joint_names": ["hip"], "points": [point], "start_in": 2.0}}
    calls = ConnectionCalls(Caller(1, "operator", 0, 0), lambda _: None, lambda _: None)
    METHODS[method](front, ClientCall(calls, CONTROL, method, given, more=False, oneway=False))
    send[0](Verdict(), 1.0)
    return front.submitted


def test_only_what_was_sent_and_may_move_waits_for_its_verdict_and_without_its_points_twice() -> None:
    (waiting,) = submitting("SubmitTrajectory", room=True).waiting.values()
    assert waiting.asked == {"start_in": 2.0, "goal_time": None, "tolerances": None}
    assert not submitting("SubmitTrajectory", room=False).waiting
    assert not submitting("Check", room=True).waiting
