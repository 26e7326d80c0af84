"""Paths are swept before the loop sees them: over the real socket of a front, while others are answered."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.loop_stand_in import NAMES, StandIn
from tests.support.processes import Daemon
from tests.support.raw_connection import Raw, code
from twind import link
from twind.client import Refused

# of h24's left arm: bent and turned in, the forearm goes into the chest
ELBOW = NAMES[5]
YAW = NAMES[4]


@pytest.fixture
def own(tmp_path: Path) -> Iterator[StandIn]:
    stand_in = StandIn(tmp_path, goal=np.zeros(24).tobytes())
    yield stand_in
    assert stand_in.close() == 0
    assert "CALL_BROKE" not in stand_in.log.read_text()


def path(*points: tuple[float, float], every: float = 1.0) -> dict[str, Any]:
    rows = [
        {"positions": list(point), "time_from_start": (place + 1) * every}
        for place, point in enumerate(points)
    ]
    return {"joint_names": [ELBOW, YAW], "points": rows}


INTO_ITSELF = path((-0.2, 0.0), (-1.5, -1.4))
CLEAR = path((-0.2, 0.0), (-0.5, 0.1))
LONG = path(*((-0.3 * (place % 2), 0.3 * (place % 3)) for place in range(2000)), every=0.02)


def submits(loop: StandIn) -> list[link.Submit]:
    return [command for command in loop.commands if isinstance(command, link.Submit)]


def test_a_self_colliding_path_reaches_the_loop_with_its_findings(own: StandIn) -> None:
    with Raw(own) as client:
        client.call("SubmitTrajectory", trajectory=INTO_ITSELF)
        client.call("Check", trajectory=INTO_ITSELF)
        client.call("Check", trajectory=CLEAR)
    first, check, clear = submits(own)
    assert (first.check_only, check.check_only) == (False, True)
    assert [each.code for each in first.refused] == [each.code for each in check.refused]
    assert first.refused[0].code == "SELF_COLLISION"
    assert first.refused[0].point == 0
    assert "l_forearm" in first.refused[0].message
    assert clear.refused == []


def test_a_verdict_is_as_old_as_the_robot_has_stood_where_it_begins(own: StandIn) -> None:
    with Raw(own) as client:
        client.call("Check", trajectory=LONG)
        assert 0.0 <= time.monotonic() - submits(own)[0].front_checked < 0.2


def test_other_clients_are_answered_during_the_check_of_a_long_path(own: StandIn) -> None:
    own.await_lookahead()
    with Raw(own) as busy, Raw(own, "observe") as other:
        other.call("GetStatus")
        busy.send("Check", parameters={"trajectory": LONG})
        waits = []
        while not submits(own) and len(waits) < 20_000:
            began = time.monotonic()
            other.call("GetStatus")
            waits.append(time.monotonic() - began)
        busy.receive()
    assert len(waits) > 5  # it took long enough to prove anything
    assert sorted(waits)[len(waits) // 2] < 0.02


def test_the_lease_of_a_path_that_waits_is_kept_and_that_of_a_check_is_not(own: StandIn) -> None:
    def kept() -> list[int]:
        return [each.client for each in own.commands if isinstance(each, link.RenewLease)]

    own.await_lookahead()
    with Raw(own) as one, Raw(own) as other:
        began = time.monotonic()
        for _ in range(15):
            one.send("Check", parameters={"trajectory": LONG})  # what is asked behind them waits
        other.send("SubmitTrajectory", parameters={"trajectory": LONG})
        other.receive()
        waited = time.monotonic() - began
    told = kept()
    assert set(told) == {submits(own)[-1].client}
    assert not submits(own)[-1].check_only
    assert len(told) >= 1 + int(waited / 0.5)  # when it came, and with every heartbeat since, each 0.25 s
    time.sleep(1.0)
    assert kept() == told  # nobody waits any more


def test_a_client_that_goes_away_takes_its_path_with_it(own: StandIn) -> None:
    own.await_lookahead()
    with Raw(own) as client:
        client.send("SubmitTrajectory", parameters={"trajectory": LONG})
        time.sleep(0.01)
    with Raw(own) as client:
        client.call("Check", trajectory=CLEAR)  # begins after it
    assert [command.check_only for command in submits(own)] == [True]


@pytest.mark.parametrize("method", ["Cancel", "Disarm", "EStop"])
def test_a_stop_ends_the_path_that_is_being_judged(own: StandIn, method: str) -> None:
    """It must not begin to move after the stop was answered."""
    own.await_lookahead()
    with Raw(own) as client, Raw(own) as other:
        client.send("SubmitTrajectory", parameters={"trajectory": LONG})
        while not client_is_heard(other):
            pass
        other.send(method)
        refused = client.receive()
        other.receive()
    assert code(refused) == "BUSY"
    assert "stopped while this was judged" in refused["parameters"]["findings"][0]["message"]
    assert not submits(own)


def client_is_heard(other: Raw) -> bool:
    """A round trip: what was sent before on another connection has been read by then."""
    other.call("GetStatus")
    other.call("GetStatus")
    return True


def test_calls_of_one_connection_stay_in_their_order(own: StandIn) -> None:
    own.await_lookahead()
    with Raw(own) as client:
        for trajectory in (LONG, CLEAR, INTO_ITSELF):
            client.send("SubmitTrajectory", parameters={"trajectory": trajectory}, oneway=True)
        client.call("Check", trajectory=CLEAR)
    assert [command.points for command in submits(own)] == [2000, 2, 2, 2]
    assert [bool(command.refused) for command in submits(own)] == [False, False, True, False]


def test_without_a_model_nothing_may_move(tmp_path: Path) -> None:
    """Broken or absent: the daemon goes on, and every path is refused."""
    stand_in = StandIn(tmp_path, binding=b"no robot", goal=np.zeros(24).tobytes())
    with Raw(stand_in) as client:
        client.call("SubmitTrajectory", trajectory=CLEAR)
        assert "error" not in client.call("GetStatus")
    assert ["no look-ahead" in finding.message for finding in submits(stand_in)[0].refused] == [True]
    assert "no motion is accepted" in stand_in.log.read_text()
    assert stand_in.close() == 0


def test_a_robot_whose_place_is_unknown_is_not_moved(tmp_path: Path) -> None:
    stand_in = StandIn(tmp_path, goal=np.full(24, np.nan).tobytes())  # and joint 23 was never heard
    with Raw(stand_in) as client:
        client.call("SubmitTrajectory", trajectory=CLEAR)
    assert [finding.joint for finding in submits(stand_in)[0].refused] == [23]
    assert stand_in.close() == 0


def test_a_whole_daemon_refuses_a_path_into_itself_and_follows_a_clear_one(tmp_path: Path) -> None:
    def motion(elbow: float, yaw: float) -> dict[str, Any]:
        points = [{"positions": [elbow, yaw], "time_from_start": 2.0}]
        return {"joint_names": ["l_elbow", "l_shoulder_yaw"], "points": points}

    running = Daemon(tmp_path / "run", "--mode", "sim")
    try:
        running.reach(motion="holding")
        with running.client() as client:
            client.call("AcquireLease")
            for method in ("SubmitTrajectory", "Check"):
                try:
                    answer = client.call(method, trajectory=motion(-1.5, -1.4))
                    findings = answer["verdict"]["refusals"]
                except Refused as error:
                    findings = error.findings
                assert {finding["code"] for finding in findings} == {"SELF_COLLISION"}, json.dumps(findings)
            assert client.call("SubmitTrajectory", trajectory=motion(-0.5, 0.1))["phase"] == "accepted"
    finally:
        running.end()
