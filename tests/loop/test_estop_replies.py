"""Replies to e-stop calls: each is answered, by what is confirmed of the stop."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import ProcedureRig
from twind import link
from twind.loop.procedures.estop_replies import KNOWN, EStopReplies
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.modes import Mode


class StopRig(ProcedureRig):
    """Calls and their replies."""

    def __init__(self) -> None:
        super().__init__()
        self.stops = EStopReplies(self)
        self.hold()

    def ask(self, ticket: int, *, client: int = 7, more: bool = False) -> None:
        self.stops.ask(link.EStop(ticket=ticket, client=client, uid=0, holder="", level="settle", more=more))

    def answered(self) -> list[tuple[int, dict[str, Any], bool]]:
        """Replies since the last look."""
        self.stops.answer()
        found = [(reply.ticket, dict(reply.parameters), reply.continues) for reply in self.book.replies]
        self.book.replies.clear()
        return found


def waits() -> Iterator[None]:
    while True:
        yield


def running(rig: StopRig, rank: Priority = Priority.ESTOP) -> None:
    rig.own(rank, waits)
    rig.torque.begin_stop()


@pytest.fixture
def rig() -> StopRig:
    return StopRig()


@pytest.mark.parametrize("rank", [Priority.ESTOP, Priority.CUT])
def test_a_stop_is_answered_when_it_has_begun_and_with_more_again_at_its_end(
    rig: StopRig, rank: Priority
) -> None:
    running(rig, rank)
    rig.ask(1)
    rig.ask(2, more=True)
    assert rig.answered() == []
    rig.torque.confirm_stop_begun()
    begun = {"state": "armed", "torque_off": False, "done": False}
    assert rig.answered() == [(1, begun, False), (2, begun, True)]
    assert rig.answered() == []
    rig.procedures.abandon()
    rig.found((0, 0, 0))
    assert rig.answered() == [(2, {"state": "armed", "torque_off": True, "done": True}, False)]
    assert rig.answered() == []


def test_a_stop_that_ends_before_it_has_begun_is_answered_once(rig: StopRig) -> None:
    running(rig)
    rig.ask(1)
    rig.ask(2, more=True)
    rig.procedures.abandon()
    rig.found((0, 0, 0))
    done = {"state": "armed", "torque_off": True, "done": True}
    assert rig.answered() == [(1, done, False), (2, done, False)]
    assert rig.answered() == []


@pytest.mark.parametrize("rank", [Priority.DISARM, Priority.FAULT, None])
def test_a_stop_that_began_nothing_is_answered_at_once(rig: StopRig, rank: Priority | None) -> None:
    if rank is not None:
        rig.own(rank, waits)
    rig.ask(1)
    assert rig.answered() == [(1, {"state": "armed", "torque_off": False, "done": True}, False)]


@pytest.mark.parametrize(
    ("mode", "torque", "off", "done"),
    [
        (Mode.LIVE, (0, -1, 0), None, False),
        (Mode.LIVE, (0, 1, 0), False, True),
        (Mode.LIVE, (-1, 1, 0), False, True),
        (Mode.MIRROR, (0, -1, 0), None, True),
        (Mode.SIM, (0, 0, 0), None, True),
    ],
)
def test_a_stop_is_done_once_torque_is_known_where_there_is_any(
    rig: StopRig, mode: Mode, torque: Any, off: bool | None, done: bool
) -> None:
    rig.torque.lose_every_bus()
    rig.condition.mode = mode
    rig.found(torque)
    rig.ask(1)
    if not done:  # a late reply may still tell
        assert rig.answered() == []
        rig.clock.sleep_until(rig.clock.now() + KNOWN + 0.001)
    assert rig.answered() == [(1, {"state": "armed", "torque_off": off, "done": done}, False)]


def test_torque_that_stays_unknown_is_waited_for_for_a_tenth_of_a_second(rig: StopRig) -> None:
    rig.torque.lose_every_bus()
    rig.found((0, -1, 0))
    begun = rig.clock.now()
    rig.ask(1)
    assert rig.answered() == []
    rig.clock.sleep_until(begun + 0.099)
    assert rig.answered() == []
    rig.clock.sleep_until(begun + 0.1)
    assert [ticket for ticket, _, _ in rig.answered()] == [1]


def test_torque_that_becomes_known_after_a_stop_is_in_its_reply(rig: StopRig) -> None:
    rig.torque.lose_every_bus()
    rig.found((0, -1, 0))
    rig.ask(1)
    assert rig.answered() == []
    rig.found((0, 0, 0))
    assert rig.answered() == [(1, {"state": "armed", "torque_off": True, "done": True}, False)]


def test_a_device_on_a_closed_bus_is_not_waited_for(rig: StopRig) -> None:
    rig.torque.lose_every_bus()
    rig.found((0, -1, 0))
    rig.hardware.away[1] = True
    rig.ask(1)
    assert rig.answered() == [(1, {"state": "armed", "torque_off": None, "done": False}, False)]


def test_calls_of_a_client_that_is_gone_are_dropped(rig: StopRig) -> None:
    running(rig)
    rig.ask(1, client=7)
    rig.ask(2, client=8)
    rig.stops.drop_client(7)
    rig.torque.confirm_stop_begun()
    assert [ticket for ticket, _, _ in rig.answered()] == [2]


def test_a_later_call_with_the_same_stop_is_answered_by_itself(rig: StopRig) -> None:
    running(rig)
    rig.ask(1, more=True)
    rig.torque.confirm_stop_begun()
    assert [ticket for ticket, _, _ in rig.answered()] == [1]
    rig.ask(2)
    assert [ticket for ticket, _, _ in rig.answered()] == [2]
    assert np.all(rig.torque.held)
