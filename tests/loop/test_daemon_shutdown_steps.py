"""The end of the daemon on SIGTERM, step by step, on scripted buses."""

from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import path
from tests.support.procedure_rig import PERIOD, PLACE, SILENT, ProcedureRig
from twind.loop.procedures.daemon_shutdown import shutdown
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode

OFF = ["hold False", "cut 0", "cut 1", "torque False"]


@pytest.fixture
def rig() -> ProcedureRig:
    rig = ProcedureRig()
    rig.hold()
    return rig


class Search:
    """An end-stop search whose servo is restored at some time."""

    def __init__(self, rig: ProcedureRig, lasts: float = 0.0) -> None:
        self._rig = rig
        self._until = rig.clock.now() + lasts
        self.reported = 0

    @property
    def unrestored(self) -> Any:
        return object() if self._rig.clock.now() < self._until else None

    def report_pending_restore(self) -> None:
        self.reported += 1


def shut(rig: ProcedureRig, search: Any = None) -> float:
    """Shut down; s that took."""
    homing: Any = search or Search(rig)
    rig.own(Priority.SHUTDOWN, lambda: shutdown(rig, rig.release, homing, rig.clock.now()))
    took = rig.until_done()
    assert rig.condition.finished
    assert homing.reported == 1
    return took


def test_an_ending_daemon_lowers_its_robot(rig: ProcedureRig) -> None:
    assert rig.executor.submit("wave", path([2.0], PLACE + 0.3)) is None
    rig.tick()
    shut(rig)
    assert rig.requests() == ["read goals", *OFF]
    assert [event.code for event in rig.book.events] == ["settling", "connected"]
    [reason] = next(goal.findings for goal in rig.executor.outcomes() if goal.id == "wave")
    assert (reason.code, reason.message) == (ReasonCode.NOT_ARMED, "the daemon ends: the robot is lowered")


def test_torque_that_was_found_on_stays_on_when_the_daemon_ends() -> None:
    rig = ProcedureRig()
    rig.found()
    assert shut(rig) == 0.0
    assert rig.hardware.log == []


def test_torque_of_an_inhibited_robot_stays_on_when_the_daemon_ends(rig: ProcedureRig) -> None:
    rig.torque.inhibit()
    shut(rig)
    assert rig.hardware.log == []


@pytest.mark.parametrize("inhibited", [False, True])
def test_torque_that_is_being_switched_goes_off_when_the_daemon_ends(inhibited: bool) -> None:
    rig = ProcedureRig()
    rig.torque.begin_energising()
    if inhibited:
        rig.torque.inhibit()
    shut(rig)
    assert rig.requests() == OFF


def lose(rig: ProcedureRig) -> None:
    """Lose every bus of a robot that was held."""
    rig.torque.lose_bus(np.ones(3, np.bool_))
    rig.hardware.connected = False
    rig.hardware.away = np.ones(3, np.bool_)
    rig.hardware.slow.torque[:] = -1


def replug(rig: ProcedureRig) -> None:
    """Let every bus return, with torque on."""
    rig.hardware.connected = True
    rig.hardware.away = np.zeros(3, np.bool_)
    rig.found()


@pytest.mark.parametrize("back", [0.5, None])
def test_a_lost_bus_is_waited_for_as_long_as_it_may_come_back(back: float | None) -> None:
    rig = ProcedureRig()
    lose(rig)
    begun = rig.clock.now()

    def plug() -> None:
        if back is not None and rig.clock.now() >= begun + back:
            replug(rig)

    rig.watched = plug
    took = shut(rig)
    if back is None:
        assert took == pytest.approx(1.5, abs=2.5 * PERIOD)
        assert rig.hardware.log == []
    else:
        assert rig.requests() == ["prepare", "hold True", "read goals", *OFF]


def test_the_waits_of_an_ending_daemon_end_with_their_last_tick() -> None:
    rig = ProcedureRig(period=1.0 / 128.0)  # a second and a half is a whole number of such ticks
    assert shut(rig, Search(rig, 9.0)) == 1.5
    rig = ProcedureRig(period=1.0 / 128.0)
    lose(rig)
    assert shut(rig) == 1.5


@pytest.mark.parametrize("identified", [True, False])
def test_torque_that_a_returned_bus_does_not_report_is_switched_off(identified: bool) -> None:
    """A CubeMars reports it only after an order, as does a Damiao that has lost its master."""
    rig = ProcedureRig()
    lose(rig)
    rig.hardware.connected = identified
    rig.hardware.away = np.zeros(3, np.bool_)
    obeys(rig)
    shut(rig)
    assert rig.requests() == OFF


def test_without_a_lost_bus_nothing_is_waited_for() -> None:
    rig = ProcedureRig()
    rig.hardware.connected = False
    assert shut(rig) == 0.0


@pytest.mark.parametrize(("lasts", "took"), [(0.5, 0.5), (9.0, 1.5)])
def test_the_servo_of_a_search_is_restored_before_the_daemon_ends(lasts: float, took: float) -> None:
    rig = ProcedureRig()
    assert shut(rig, Search(rig, lasts)) == pytest.approx(took, abs=2.5 * PERIOD)


# ------------------------------------------------------------------------------- ordered off before


def obeys(rig: ProcedureRig, lost: slice | None = None) -> None:
    """Torque that is sent off reads off from the next tick on; that of joints `lost` is unknown."""
    sent = rig.hardware.log.count("torque False")

    def read() -> None:
        if rig.hardware.log.count("torque False") > sent:
            rig.hardware.slow.torque[:] = 0
            if lost is not None:
                rig.hardware.slow.torque[lost] = -1

    rig.watched = read


@pytest.mark.parametrize("level", ["cut", None])
def test_torque_off_that_was_not_confirmed_is_sent_again_and_nothing_is_driven(level: str | None) -> None:
    rig = ProcedureRig()
    rig.found()
    if level:
        rig.torque.latch_stop(level)
    rig.torque.begin_release()
    rig.torque.leave_unconfirmed()
    obeys(rig)
    assert shut(rig) < 0.1
    assert rig.requests() == OFF
    assert rig.codes() == ["TORQUE_MISMATCH"]


def test_a_servo_that_keeps_its_torque_after_a_cut_does_not_keep_the_daemon() -> None:
    rig = ProcedureRig()
    rig.found()
    rig.torque.latch_stop("cut")
    rig.hardware.failing["torque False"] = [SILENT] * 1000
    assert shut(rig) < 3.0
    assert set(rig.requests()) == set(OFF)
    assert "may be on" in rig.book.events[-1].message


def test_a_stop_that_a_lost_bus_missed_lowers_the_robot_when_it_returns() -> None:
    rig = ProcedureRig()
    lose(rig)
    rig.torque.latch_stop("settle")
    begun = rig.clock.now()

    def plug() -> None:
        if not rig.hardware.connected and rig.clock.now() >= begun + 0.5:
            replug(rig)
            obeys(rig)

    rig.watched = plug
    shut(rig)
    assert rig.requests() == ["prepare", "hold True", "read goals", *OFF]
    assert rig.codes() == ["settling", "connected"]


@pytest.mark.parametrize("back", [1.0, None])
def test_a_bus_that_is_lost_while_the_robot_is_lowered_is_waited_for(
    rig: ProcedureRig, back: float | None
) -> None:
    upper = np.array([False, False, True])
    ends: list[float] = []

    def watch() -> None:
        if "read goals" in rig.hardware.log and not rig.hardware.away.any() and not ends:
            rig.torque.lose_bus(upper)
            rig.hardware.away = upper
            rig.hardware.slow.torque[2] = -1
        if "torque False" in rig.hardware.log and not ends:
            rig.hardware.slow.torque[:2] = 0
            ends.append(rig.clock.now())
        if ends and back and rig.clock.now() >= ends[0] + back and rig.hardware.away.any():
            rig.hardware.away = np.zeros(3, np.bool_)
            rig.hardware.slow.torque[2] = 1
        if rig.hardware.log.count("torque False") == 2:
            rig.hardware.slow.torque[2] = 0

    rig.watched = watch
    shut(rig)
    took = rig.clock.now() - ends[0]
    assert rig.requests().count("torque False") == (1 if back is None else 2)
    assert took == pytest.approx(1.5 if back is None else back, abs=5 * PERIOD)
    assert ("toe may be on" in rig.book.events[-2].message) is (back is None)


@pytest.mark.parametrize("mode", [Mode.SIM, Mode.MIRROR])
def test_where_nothing_can_be_written_a_stop_does_not_delay_the_end(mode: Mode) -> None:
    rig = ProcedureRig()
    rig.condition.mode = mode
    rig.found()
    rig.torque.latch_stop("cut")
    assert shut(rig) == 0.0
    assert rig.hardware.log == []


def test_torque_that_is_being_switched_goes_off_without_a_wait_for_a_lost_bus() -> None:
    rig = ProcedureRig()
    lose(rig)
    rig.torque.begin_energising()
    rig.own(Priority.SHUTDOWN, lambda: shutdown(rig, rig.release, Search(rig), rig.clock.now()))  # type: ignore[arg-type]
    assert rig.requests() == OFF


def test_a_bus_that_is_back_already_does_not_delay_the_way_down(rig: ProcedureRig) -> None:
    rig.torque.lose_bus(np.array([False, False, True]))
    begun = rig.clock.now()
    rig.own(Priority.SHUTDOWN, lambda: shutdown(rig, rig.release, Search(rig), begun))  # type: ignore[arg-type]
    rig.ticks(5)
    assert rig.requests() == ["read goals"], "the way to the rest pose has begun"
