"""The fail-safe step by step, on scripted buses: what it judges, when it tries again, and how it ends."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.failsafe_steps_rig import FailsafeRig
from tests.support.procedure_rig import BROKEN, PERIOD, REST, SILENT
from twind.loop.procedures.failsafe import LONGEST, TRIES
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.loop.procedures.torque_switching import INSIST
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode

OFF = ["hold False", "cut 0", "cut 1", "torque False"]
TAKEN = ["prepare", "hold True", "read goals"]


def untouched(rig: FailsafeRig) -> bool:
    """Nothing was asked of the devices."""
    return rig.requests() == [] and rig.hardware.goals == []


def events_of(rig: FailsafeRig) -> list[tuple[str, str]]:
    """Level and text of each event of the fail-safe."""
    return [(event.level, event.message) for event in rig.book.events if event.code == "FAILSAFE"]


def begun(rig: FailsafeRig) -> list[float]:
    """The times at which a way down began, s after the start of the rig."""
    return [
        event.time - 100.0 for event in rig.book.events if event.message.startswith("the robot is lowered")
    ]


# ------------------------------------------------------------------------------- the run


@pytest.mark.parametrize("support", ["gantry", "fixed", "free", "stilts"])
def test_a_whole_robot_is_taken_over_lowered_and_released(support: str) -> None:
    rig = FailsafeRig(support)
    assert rig.safe.left == "it was ended before it had found out"
    # 0.4 rad at a quarter of the limits: 2 s; then a free one rests for 0.5 s
    assert rig.finish() == pytest.approx(2.03 if rig.robot.carried else 2.53, abs=0.06)
    assert rig.safe.left == ""
    assert rig.requests() == [*TAKEN, *OFF]
    assert rig.robot.written == pytest.approx(REST)
    assert rig.codes() == ["FAILSAFE", "settling", "connected", "FAILSAFE"]
    assert events_of(rig) == [
        ("warning", f"the robot is lowered, then torque goes off (support: {support})"),
        ("info", "torque was read back off everywhere"),
    ]
    assert rig.extended == [70.0]  # s, the longest time that it may need


def crawl(rig: FailsafeRig, velocity: float) -> None:
    """No joint may be faster, rad/s."""
    slow = replace(rig.robot.limits, velocity=np.full(3, velocity))
    rig.robot.description = replace(rig.robot.description, limits=slow, period=0.05)
    rig.executor = type(rig.executor)(slow, 0.05)


def test_a_way_that_would_take_longer_than_15_s_uses_more_of_the_limits() -> None:
    rig = FailsafeRig()
    crawl(rig, 0.15)  # 20 s at a quarter of it
    assert rig.finish() == pytest.approx(15.0, abs=0.5)
    assert rig.extended == [LONGEST]


@pytest.mark.parametrize(("support", "lasts"), [("gantry", 39.5), ("free", 31.0)])
def test_a_way_that_is_longer_than_30_s_is_awaited_where_the_robot_is_carried_and_else_damped(
    support: str, lasts: float
) -> None:
    rig = FailsafeRig(support)
    crawl(rig, 0.02)
    assert rig.finish() == pytest.approx(lasts, abs=0.8)
    assert ("damp" in rig.requests()) is (support == "free")
    assert rig.safe.left == ""
    assert rig.extended == [LONGEST, pytest.approx(39.5 + 10.0, abs=0.1)]


def test_a_robot_without_torque_gets_no_request() -> None:
    rig = FailsafeRig(torque=(0, 0, 0))
    assert rig.finish() <= 2 * PERIOD
    assert rig.safe.left == ""
    assert untouched(rig)
    assert events_of(rig) == [("info", "torque was read back off everywhere")]


def test_torque_that_goes_off_during_the_wait_ends_it() -> None:
    rig = FailsafeRig()
    rig.hardware.connected = False
    rig.safe.begin()
    rig.ticks(50)
    rig.found((0, 0, 0))
    rig.tick()
    assert (rig.condition.finished, rig.safe.left) == (True, "")
    assert untouched(rig)


def unknown(rig: FailsafeRig) -> None:
    rig.hardware.slow.torque[2] = -1


def old(rig: FailsafeRig) -> None:
    rig.age(0.0, 0.101, 0.0)


def apart(rig: FailsafeRig) -> None:
    rig.hardware.connected = False


def undetermined(rig: FailsafeRig) -> None:
    """As of a missing device: its joint is not judged."""
    rig.verified.unjudged = np.array([False, False, True])
    rig.identity.missing["upper"] = (Finding(ReasonCode.DEVICE_MISSING, 2, message="nothing answers"),)


@pytest.mark.parametrize("lacks", [unknown, old, apart, undetermined])
def test_what_is_not_known_of_a_carried_robot_is_awaited_for_10_s(lacks: Any) -> None:
    rig = FailsafeRig()
    lacks(rig)
    rig.finish()
    assert begun(rig)[0] == pytest.approx(10.0, abs=2 * PERIOD)
    assert rig.requests()[:2] == TAKEN[:2]


@pytest.mark.parametrize("lacks", [unknown, old, apart, undetermined])
def test_the_way_down_begins_as_soon_as_everything_is_known(lacks: Any) -> None:
    rig = FailsafeRig()
    lacks(rig)
    rig.safe.begin()
    rig.ticks(100)
    assert untouched(rig)
    rig.found()
    rig.age(0.0, 0.1, 0.0)
    rig.hardware.connected = True
    rig.verified.unjudged = np.zeros(3, np.bool_)
    rig.tick()
    assert begun(rig) == pytest.approx([1.01])


def test_a_reason_against_the_way_down_is_reported_and_nothing_is_written() -> None:
    rig = FailsafeRig()
    rig.condition.mode = Mode.MIRROR
    assert rig.finish() <= 2 * PERIOD
    assert rig.safe.left == "torque is on, and mode mirror of the settings writes nothing"
    assert events_of(rig) == [("error", rig.safe.left)]
    assert untouched(rig)


# ------------------------------------------------------------------------------- tried again


def test_a_free_robot_that_cannot_be_taken_over_completely_is_tried_three_times_and_keeps_its_torque() -> (
    None
):
    rig = FailsafeRig("free")
    rig.hardware.failing["prepare"] = SILENT
    rig.finish()
    assert rig.requests() == ["prepare"] * TRIES
    assert rig.safe.left == f"torque is on, not every device could be taken over: {SILENT}"
    assert events_of(rig)[-1] == ("error", rig.safe.left)


def test_a_second_take_over_may_succeed() -> None:
    rig = FailsafeRig("free")
    rig.hardware.failing["prepare"] = [SILENT, None]
    rig.finish()
    assert rig.safe.left == ""
    assert rig.requests() == ["prepare", *TAKEN, *OFF]


def test_the_reason_of_a_first_refusal_is_not_that_of_a_later_end() -> None:
    """The second take-over succeeds, and every servo is silent when torque is to go off."""
    rig = FailsafeRig("free")
    rig.hardware.failing["prepare"] = [SILENT, None]
    rig.hardware.failing["torque False"] = BROKEN
    rig.obeys[:] = False

    def fall_silent() -> None:
        if rig.torque.unconfirmed:
            rig.age(1.0, 1.0, 1.0)

    rig.watched = fall_silent
    rig.finish()
    assert rig.safe.left == "torque could not be read back off from hip, knee, toe: no answer"


def test_a_carried_robot_with_a_servo_that_keeps_its_torque_is_lowered_three_times() -> None:
    rig = FailsafeRig()
    rig.obeys[2] = False
    rig.finish()
    assert len(begun(rig)) == TRIES == 3
    assert rig.safe.left == "torque could not be read back off from toe: no answer"


@pytest.mark.parametrize(("at", "ways"), [(19.9, 2), (20.1, 1)])
def test_no_way_down_begins_after_20_s(at: float, ways: int) -> None:
    rig = FailsafeRig()
    rig.obeys[2] = False
    rig.age(0.0, 0.0, 0.101)

    def answer() -> None:
        if rig.clock.now() >= 100.0 + at:
            rig.age(0.0, 0.0, 0.0)
            rig.obeys[2] = True

    rig.watched = answer
    rig.finish()
    assert begun(rig) == pytest.approx([10.0, at][:ways], abs=2 * PERIOD)
    assert (rig.safe.left == "") is (ways == 2)


def test_a_bus_that_is_closed_is_awaited_once_more_after_the_others_are_released() -> None:
    rig = FailsafeRig()
    rig.unplug()
    took = rig.finish()
    assert took > 20.0
    assert len(begun(rig)) == 1
    assert rig.safe.left == "whether torque is on is not known of toe: upper is not open"


def test_torque_off_without_a_confirmation_is_the_end_for_a_robot_that_stands_freely() -> None:
    rig = FailsafeRig("free")
    rig.hardware.failing["torque False"] = BROKEN
    rig.obeys[:] = False
    assert rig.finish() < 2.6 + INSIST + 0.2
    assert rig.requests().count("prepare") == 1
    assert rig.safe.left == "torque could not be read back off from hip, knee, toe: no answer"


def test_torque_off_without_a_confirmation_is_no_failed_take_over_of_a_carried_robot() -> None:
    rig = FailsafeRig()
    rig.hardware.failing["torque False"] = BROKEN
    rig.obeys[:] = False
    rig.finish()
    assert rig.requests().count("prepare") == TRIES
    assert rig.safe.left == "torque could not be read back off from hip, knee, toe: no answer"


@pytest.mark.parametrize("support", ["gantry", "free"])
def test_torque_off_that_is_sent_again_is_completed_before_the_robot_is_judged(support: str) -> None:
    rig = FailsafeRig(support)

    def again() -> Procedure:
        for _ in range(50):
            yield
        rig.found((0, 0, 0))
        return None

    rig.safe.begin()
    rig.own(Priority.DISARM, again)
    rig.ticks(49)
    assert not rig.condition.finished
    rig.ticks(3)
    assert (rig.condition.finished, rig.safe.left) == (True, "")
    assert untouched(rig)


# ------------------------------------------------------------------------------- ended by force


def test_a_stop_during_the_wait_ends_it_at_once() -> None:
    rig = FailsafeRig()
    rig.hardware.connected = False
    rig.safe.begin()
    rig.ticks(100)
    rig.safe.stop()
    rig.tick()
    assert rig.condition.finished
    assert rig.safe.left == "it was ended before it had found out"
    assert untouched(rig)


def test_a_stop_in_the_tick_in_which_all_is_known_begins_no_way_down() -> None:
    rig = FailsafeRig()
    rig.safe.begin()
    rig.safe.stop()
    rig.tick()
    assert rig.condition.finished
    assert untouched(rig)


def test_a_stop_on_the_way_down_completes_it() -> None:
    rig = FailsafeRig()
    rig.safe.begin()
    rig.ticks(50)
    rig.safe.stop()
    rig.until_done()
    assert (rig.condition.finished, rig.safe.left) == (True, "")
    assert rig.requests() == [*TAKEN, *OFF]


def inhibit(rig: FailsafeRig) -> None:
    """Forbid writing, as the guard does (`internal_faults.inhibit`)."""
    rig.torque.inhibit()
    rig.condition.latch(Finding(ReasonCode.FOREIGN_TRAFFIC, message="a stranger"))
    rig.procedures.abandon()


@pytest.mark.parametrize("after", [0, 50])
def test_an_inhibit_before_and_on_the_way_down_leaves_torque_on(after: int) -> None:
    rig = FailsafeRig()
    rig.safe.begin()
    rig.ticks(after)
    done = len(rig.requests())
    inhibit(rig)
    rig.ticks(2)
    assert rig.condition.finished
    assert rig.requests()[done:] == []
    assert rig.safe.left == (
        "torque could not be read back off from hip, knee, toe: FOREIGN_TRAFFIC: a stranger"
    )


def test_an_inhibit_after_a_way_down_ends_the_fail_safe_at_once() -> None:
    rig = FailsafeRig()
    rig.obeys[:] = False
    rig.safe.begin()
    rig.ticks(50)
    rig.torque.inhibit()
    rig.until_done()
    assert rig.condition.finished
    assert len(begun(rig)) == 1


def test_a_defect_at_the_take_over_ends_the_fail_safe_and_leaves_torque_on() -> None:
    """Else the program would go on without anything that could end it."""
    rig = FailsafeRig("free")

    def prepare(*_: Any) -> Any:
        raise TypeError("a defect")

    rig.hardware.prepare = prepare
    with pytest.raises(TypeError):
        rig.finish()
    assert rig.condition.finished
    assert rig.safe.left == "it was ended before it had found out"
    assert rig.hardware.slow.torque.all()
