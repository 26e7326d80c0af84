"""Paths are swept before the loop sees them: over the real socket of a front, while others are answered."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.loop_stand_in import NAMES
from tests.support.processes import until
from tests.support.raw_connection import Raw, code
from tests.support.shared_front import SharedFront, shared_front
from twind import link

# of h24's left arm: bent and turned in, the forearm goes into the chest
ELBOW = NAMES[5]
YAW = NAMES[4]


@contextmanager
def made(folder: Path) -> Iterator[SharedFront]:
    """A front whose robot holds at zero, once it has its model."""
    with shared_front(folder, goal=np.zeros(24).tobytes()) as front:
        front.await_lookahead()
        yield front


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedFront]:
    with made(tmp_path_factory.mktemp("front")) as front:
        yield front


@pytest.fixture
def front(shared: SharedFront) -> SharedFront:
    shared.begin()
    return shared


@pytest.fixture
def fresh(tmp_path: Path) -> Iterator[SharedFront]:
    with made(tmp_path) as front:
        yield front


def path(*points: tuple[float, float], every: float = 1.0) -> dict[str, Any]:
    rows = [
        {"positions": list(point), "time_from_start": (place + 1) * every}
        for place, point in enumerate(points)
    ]
    return {"joint_names": [ELBOW, YAW], "points": rows}


INTO_ITSELF = path((-0.2, 0.0), (-1.5, -1.4))
CLEAR = path((-0.2, 0.0), (-0.5, 0.1))
LONG = path(*((-0.3 * (place % 2), 0.3 * (place % 3)) for place in range(2000)), every=0.02)
SLOW = path(*((-2.0 * (place % 2), 0.3 * (place % 3)) for place in range(2000)), every=0.029)  # 1 s of checks


def test_the_lease_of_a_path_that_waits_is_kept_and_that_of_a_check_is_not(fresh: SharedFront) -> None:
    """A separate front, since a process may submit only so many trajectories in a second."""

    def kept() -> list[int]:
        return [each.client for each in fresh.commands if isinstance(each, link.RenewLease)]

    with Raw(fresh) as one, Raw(fresh) as other:
        for _ in range(15):
            one.send("Check", parameters={"trajectory": LONG})  # what is asked behind them waits
        other.send("SubmitTrajectory", parameters={"trajectory": LONG})
        until(kept, 10.0, "the path has not reached the queue")
        began = time.monotonic()
        other.receive()
        waited = time.monotonic() - began
    told = kept()
    (submitted,) = (each for each in fresh.submits() if not each.check_only)
    assert set(told) == {submitted.client}
    assert len(told) >= 1 + int(waited / 0.5)  # when it came, and with every heartbeat since, each 0.25 s
    time.sleep(1.0)
    assert kept() == told  # nobody waits any more


def test_a_self_colliding_path_reaches_the_loop_with_its_findings(front: SharedFront) -> None:
    with Raw(front) as client:
        client.call("SubmitTrajectory", trajectory=INTO_ITSELF)
        client.call("Check", trajectory=INTO_ITSELF)
        client.call("Check", trajectory=CLEAR)
    first, check, clear = front.submits()
    assert (first.check_only, check.check_only) == (False, True)
    assert [each.code for each in first.refused] == [each.code for each in check.refused]
    assert first.refused[0].code == "SELF_COLLISION"
    assert first.refused[0].point == 0
    assert "l_forearm" in first.refused[0].message
    assert clear.refused == []


def test_a_verdict_is_as_old_as_the_robot_has_stood_where_it_begins(front: SharedFront) -> None:
    with Raw(front) as client:
        client.call("Check", trajectory=LONG)
        assert 0.0 <= time.monotonic() - front.submits()[0].front_checked < 0.2


def test_a_client_that_goes_away_takes_its_path_with_it(front: SharedFront) -> None:
    with ExitStack() as opened:
        # The path waits behind this one: this process may be late beside other tests.
        opened.enter_context(Raw(front)).send("Check", parameters={"trajectory": SLOW})
        other = opened.enter_context(Raw(front))
        with Raw(front) as client:
            client.send("SubmitTrajectory", parameters={"trajectory": SLOW})
            other.call("GetStatus")
        other.call("Check", trajectory=CLEAR)  # begins after all of them
    assert [command.check_only for command in front.submits()] == [True] * 2


@pytest.mark.parametrize("method", ["Cancel", "Disarm", "EStop"])
def test_a_stop_ends_the_path_that_is_being_judged(front: SharedFront, method: str) -> None:
    """It must not begin to move after the stop was answered."""
    with Raw(front) as ahead, Raw(front) as client, Raw(front) as other:
        # The path waits behind this one: this process may be late beside other tests.
        ahead.send("Check", parameters={"trajectory": SLOW})
        client.send("SubmitTrajectory", parameters={"trajectory": SLOW})
        for _ in range(2):  # round trips: what was sent before on the other connection has been read
            other.call("GetStatus")
        other.send(method)
        refused = client.receive()
        other.receive()
    assert code(refused) == "BUSY"
    assert "stopped while this was judged" in refused["parameters"]["findings"][0]["message"]
    assert all(each.check_only for each in front.submits())


@pytest.mark.parametrize("method", ["Cancel", "Disarm", "EStop"])
@pytest.mark.parametrize("own", [True, False], ids=["of its own connection", "of another one"])
def test_a_motion_that_waits_for_its_turn_does_not_begin_after_a_stop(
    front: SharedFront, method: str, *, own: bool
) -> None:
    """Else each motion that a stop ends would let the next one begin that was sent before the stop."""
    front.answers[link.Submit] = lambda command: [
        link.Reply(ticket=command.ticket, parameters={"phase": "accepted"}, continues=True)
    ]
    with Raw(front) as client, Raw(front) as other:
        for _ in range(2):
            client.send("SubmitTrajectory", parameters={"trajectory": CLEAR}, more=True)
        for waiting in ("Arm", "Reset", "GetStatus"):
            client.send(waiting, parameters={})
        running = front.await_command(link.Submit)
        assert isinstance(running, link.Submit)
        (client if own else other).send(method)
        front.await_command(getattr(link, method))
        front.send(link.Reply(ticket=running.ticket, parameters={"phase": "cancelled"}))
        assert [client.receive()["parameters"]["phase"] for _ in range(2)] == ["accepted", "cancelled"]
        for _ in range(3):
            refused = client.receive()
            assert code(refused) == "BUSY"
            assert "stopped before its turn" in refused["parameters"]["findings"][0]["message"]
        assert "error" not in client.receive()
        (client if own else other).receive()
        client.send("SubmitTrajectory", parameters={"trajectory": CLEAR}, more=True)  # sent after the stop
        assert client.receive()["parameters"]["phase"] == "accepted"
    assert len(front.submits()) == 2
    assert not [each for each in front.commands if isinstance(each, link.Arm | link.Reset)]


def test_calls_of_one_connection_stay_in_their_order(front: SharedFront) -> None:
    with Raw(front) as client:
        for trajectory in (LONG, CLEAR, INTO_ITSELF):
            client.send("SubmitTrajectory", parameters={"trajectory": trajectory}, oneway=True)
        client.call("Check", trajectory=CLEAR)
    assert [command.points for command in front.submits()] == [2000, 2, 2, 2]
    assert [bool(command.refused) for command in front.submits()] == [False, False, True, False]


@pytest.mark.parametrize(
    ("given", "joint", "why"),
    [
        ({"binding": b"no robot", "goal": np.zeros(24).tobytes()}, None, "no look-ahead"),
        ({"goal": np.full(24, np.nan).tobytes()}, 23, ""),  # and joint 23 has never replied
    ],
    ids=["no model", "unknown position"],
)
def test_without_a_model_or_a_position_no_path_is_accepted(
    tmp_path: Path, given: dict[str, bytes], joint: int | None, why: str
) -> None:
    """The front itself runs on."""
    with shared_front(tmp_path, **given) as front, Raw(front) as client:
        client.call("SubmitTrajectory", trajectory=CLEAR)
        assert "error" not in client.call("GetStatus")
        ((finding,),) = [each.refused for each in front.submits()]
        assert finding.joint == joint and why in finding.message
        assert ("no motion is accepted" in front.logged()) == bool(why)
