"""The way of a held robot to its rest pose, and when torque may go off there. On scripted buses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import path
from tests.support.procedure_rig import BROKEN, PERIOD, PLACE, REST, WHY, ProcedureRig
from twind.loop.procedures.lowering import OBEYED, USUAL, SettleProfile, lower
from twind.robot.modes import Motion


@pytest.fixture
def rig() -> ProcedureRig:
    rig = ProcedureRig()
    rig.hold()
    return rig


def lowered(rig: ProcedureRig, profile: SettleProfile = USUAL) -> tuple[bool, float]:
    """Lower; whether torque may go off, and s that took."""
    begun = rig.clock.now()
    done = rig.run(lower(rig, profile, rig.extended.append))
    assert isinstance(done, bool)
    return done, rig.clock.now() - begun


def slowed(rig: ProcedureRig, velocity: float) -> None:
    """The robot's joints move so slowly from now on, rad/s."""
    limits = replace(rig.robot.limits, velocity=np.full(3, velocity))
    rig.robot.description = replace(rig.robot.description, limits=limits)
    rig.executor.limits = limits


def supported(support: str) -> ProcedureRig:
    rig = ProcedureRig(support=support)
    rig.hold()
    return rig


@pytest.mark.parametrize("support", ["fixed", "gantry"])
def test_a_supported_robot_may_be_released_at_the_end_of_its_way(support: str) -> None:
    rig = supported(support)
    done, took = lowered(rig)
    assert done and took < 4.0
    assert rig.robot.written == pytest.approx(REST, abs=0.02)
    assert rig.executor.motion is Motion.HOLDING
    assert rig.book.events == [] and rig.extended == []


@pytest.mark.parametrize("speed", [0.25, 0.5])
def test_the_way_takes_its_share_of_the_limits(rig: ProcedureRig, speed: float) -> None:
    slowed(rig, 0.5)
    _, took = lowered(rig, SettleProfile(speed=speed, way=10.0, within=20.0))
    assert took == pytest.approx(1.875 * 0.4 / (speed * 0.5), abs=0.1)


def test_a_joint_whose_travel_ends_before_the_rest_pose_rests_at_its_end(rig: ProcedureRig) -> None:
    bounds = replace(
        rig.robot.limits, lower=REST + np.array([0.05, -1.0, -1.0]), upper=REST + np.array([1.0, 1.0, -0.1])
    )
    rig.robot.description = replace(rig.robot.description, limits=bounds)
    rig.executor.limits = bounds
    done, _ = lowered(rig)
    assert done
    assert rig.robot.written == pytest.approx(REST + np.array([0.05, 0.0, -0.1]), abs=1e-6)


def test_a_way_that_would_be_slow_takes_three_seconds_and_a_fifth(rig: ProcedureRig) -> None:
    slowed(rig, 0.3)
    done, took = lowered(rig)
    assert done and took == pytest.approx(3.2, abs=0.05)


@pytest.mark.parametrize("support", ["free", "", "wall"])
def test_any_other_robot_is_released_only_at_rest_in_its_rest_pose(support: str) -> None:
    rig = supported(support)
    arrived: list[float] = []

    def note() -> None:
        if not arrived and np.abs(rig.robot.measured.position - REST).max() <= 0.1:
            arrived.append(rig.clock.now())

    rig.watched = note
    done, _ = lowered(rig)
    assert done
    assert rig.clock.now() - arrived[0] >= 0.5


@pytest.mark.parametrize(
    ("odd", "fine"),
    [
        ({"velocity": np.array([0.0, 0.05, 0.0])}, True),
        ({"velocity": np.array([0.0, -0.051, 0.0])}, False),
        ({"velocity": np.array([0.0, np.nan, 0.0])}, False),
        ({"position": REST + np.array([0.1, 0.0, 0.0])}, True),
        ({"position": REST + np.array([0.0, 0.0, -0.1001])}, False),
        ({"age": np.array([0.5, 0.0, 0.0])}, True),
        ({"age": np.array([0.51, 0.0, 0.0])}, False),
    ],
)
def test_a_free_robot_that_moves_or_is_silent_or_away_from_its_rest_pose_is_not_released(
    odd: dict[str, Any], fine: bool
) -> None:
    rig = supported("free")

    def disturb() -> None:
        if rig.executor.motion is Motion.HOLDING:
            rig.read(**{"position": REST, **odd})

    rig.watched = disturb
    done, took = lowered(rig)
    assert done == fine
    assert rig.codes() == ([] if fine else ["SETTLE"])
    if not fine:
        assert took == pytest.approx(4.0, abs=1.5 * PERIOD)
        [event] = rig.book.events
        assert (event.level, event.message) == ("error", "not at rest in the rest pose")


def test_half_a_second_of_rest_counts_from_its_begin() -> None:
    rig = ProcedureRig(support="free")
    rig.hold(REST + 0.001)
    begun = rig.clock.now()

    def tremble() -> None:
        fast = rig.clock.now() < begun + 1.0
        rig.read(velocity=np.full(3, 0.1 if fast else 0.0))

    rig.watched = tremble
    done, took = lowered(rig)
    assert done and took == pytest.approx(1.5, abs=3.5 * PERIOD)


@pytest.mark.parametrize(("velocity", "lasts"), [(0.0, 0.5), (0.1, 3.0)])
def test_rest_and_its_bound_end_with_their_last_tick(velocity: float, lasts: float) -> None:
    rig = ProcedureRig(support="free", period=1.0 / 128.0)  # half a second is a whole number of such ticks
    rig.hold(REST)
    rig.torque.confirm_stop_begun()
    rig.executor.submit = lambda *args: rig.executor.begin(REST)
    rig.read(velocity=np.full(3, velocity))
    done, took = lowered(rig, SettleProfile(within=3.0))
    assert done is (velocity == 0.0)
    assert took == lasts + (1.0 / 128.0 if done else 0.0)


# --------------------------------------------------------------------------------------------- no way


def test_a_way_that_is_refused_is_reported_with_the_reason(
    rig: ProcedureRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig.executor, "submit", lambda *args: WHY)
    done, took = lowered(rig)
    assert not done and took == 0.0
    [event] = rig.book.events
    assert (event.level, event.code, event.findings) == ("error", "FOLLOW_ERR", [WHY])
    assert event.message == f"no way to the rest pose: {WHY.message}"


def test_without_a_reference_there_is_no_way(rig: ProcedureRig) -> None:
    rig.executor.idle()
    assert lowered(rig) == (False, 0.0)
    assert [event.message for event in rig.book.events] == ["the way to the rest pose came to no end"]
    assert rig.book.events[0].level == "error"


def test_where_damping_was_demanded_there_is_no_way_and_nothing_more_to_report(rig: ProcedureRig) -> None:
    rig.torque.demand_damping(rig.clock.now())
    assert lowered(rig) == (False, 0.0)
    assert rig.book.events == []


def test_a_demand_for_damping_ends_the_way(rig: ProcedureRig) -> None:
    begun = rig.clock.now()

    def demand() -> None:
        if rig.clock.now() > begun + 0.3:
            rig.torque.demand_damping(rig.clock.now())

    rig.watched = demand
    done, took = lowered(rig)
    assert not done and took == pytest.approx(0.32, abs=2 * PERIOD)
    assert rig.book.events == []


def test_a_demand_for_damping_ends_the_wait_for_rest() -> None:
    rig = ProcedureRig(support="free")
    rig.hold(REST)
    begun = rig.clock.now()

    def demand() -> None:
        rig.read(velocity=np.ones(3))
        if rig.clock.now() > begun + 1.0:
            rig.torque.demand_damping(rig.clock.now())

    rig.watched = demand
    done, took = lowered(rig)
    assert not done and took == pytest.approx(1.0, abs=3 * PERIOD)


def test_a_way_that_is_interrupted_is_tried_once_more(rig: ProcedureRig) -> None:
    due = [rig.clock.now() + 0.3]

    def interrupt() -> None:
        if due and rig.clock.now() > due[0]:
            due.clear()
            rig.executor.stop("aborted", ())

    rig.watched = interrupt
    done, _ = lowered(rig)
    assert done and rig.book.events == []


def test_a_way_that_is_interrupted_twice_comes_to_no_end(rig: ProcedureRig) -> None:
    count = iter(range(10_000))

    def interrupt() -> None:
        if next(count) % 30 == 29:
            rig.executor.stop("aborted", ())

    rig.watched = interrupt
    done, took = lowered(rig)
    assert not done and took == pytest.approx(0.6, abs=4 * PERIOD)
    assert [event.message for event in rig.book.events] == ["the way to the rest pose came to no end"]


def test_an_executor_that_lost_its_reference_under_way_has_not_arrived(rig: ProcedureRig) -> None:
    begun = rig.clock.now()

    def idle() -> None:
        if rig.clock.now() > begun + 0.3:
            rig.executor.idle()

    rig.watched = idle
    assert lowered(rig)[0] is False
    assert [event.message for event in rig.book.events] == ["the way to the rest pose came to no end"]


@pytest.mark.parametrize("joint", range(3))
def test_one_joint_that_is_far_away_has_not_arrived(
    rig: ProcedureRig, joint: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = REST.copy()
    place[joint] += 0.5
    monkeypatch.setattr(rig.executor, "submit", lambda *args: rig.executor.begin(place))
    assert lowered(rig)[0] is False


def test_goals_at_exactly_a_fiftieth_of_a_radian_have_arrived(
    rig: ProcedureRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = REST + np.array([0.02, 0.0, 0.0])
    monkeypatch.setattr(rig.executor, "submit", lambda *args: rig.executor.begin(place))
    assert lowered(rig)[0] is True


@pytest.mark.parametrize(("off", "done"), [(0.0199, True), (0.0201, False)])
def test_goals_within_a_fiftieth_of_a_radian_have_arrived(
    rig: ProcedureRig, off: float, done: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig.executor, "submit", lambda *args: rig.executor.begin(REST + off))
    assert lowered(rig)[0] is done


def test_without_time_no_way_begins(rig: ProcedureRig) -> None:
    assert lowered(rig, SettleProfile(within=0.0)) == (False, 0.0)
    assert rig.codes() == ["SETTLE"]


# --------------------------------------------------------------------------------------------- time


def stuck(rig: ProcedureRig, monkeypatch: pytest.MonkeyPatch) -> None:
    """The motion to the rest pose makes no progress."""
    rig.executor.pace = 0.001
    monkeypatch.setattr(type(rig.executor), "goal", lambda self, now: self.reference)


def test_a_way_that_makes_no_progress_is_given_up_after_four_seconds(
    rig: ProcedureRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    stuck(rig, monkeypatch)
    done, took = lowered(rig)
    assert not done and took == pytest.approx(4.0, abs=2 * PERIOD)


@pytest.mark.parametrize(("support", "late"), [("fixed", 1.0), ("gantry", 1.0), ("free", None)])
def test_a_longer_way_is_reported_asked_for_and_given_a_second_more_unless_the_robot_stands_free(
    support: str, late: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = supported(support)
    slowed(rig, 0.1)
    lasts = 1.875 * 0.4 / (0.95 * 0.1)
    stuck(rig, monkeypatch)
    done, took = lowered(rig)
    assert not done
    assert took == pytest.approx(4.0 if late is None else lasts + late, abs=0.03)
    assert rig.extended == [pytest.approx(lasts + 10.0, abs=0.1)]
    event = rig.book.events[0]
    assert (event.level, event.code) == ("warning", "SETTLE")
    assert event.message == f"the way to the rest pose takes {lasts:.1f} s"


def test_a_way_of_four_seconds_asks_for_nothing(rig: ProcedureRig) -> None:
    slowed(rig, 1.875 * 0.4 / (0.95 * 3.9))
    done, took = lowered(rig)
    assert done and took == pytest.approx(3.9, abs=0.05)
    assert rig.extended == []


def test_a_way_that_lasts_just_as_long_as_there_is_time_asks_for_nothing(rig: ProcedureRig) -> None:
    slowed(rig, 0.3)
    lowered(rig, SettleProfile(way=3.2, within=3.2))
    assert rig.extended == []


def test_a_way_that_begins_in_motion_lasts_until_its_last_point(rig: ProcedureRig) -> None:
    assert rig.executor.submit("wave", path([2.0], PLACE + 0.3)) is None
    rig.ticks(80)
    assert rig.executor.reference.velocity.any()
    lowered(rig, SettleProfile(speed=0.01, way=8.0, within=0.5))
    assert rig.extended == [pytest.approx(18.0, abs=0.1)]


def test_the_time_of_a_robot_that_stands_free_ends_with_its_last_tick() -> None:
    rig = ProcedureRig(support="free", period=1.0 / 128.0)  # half a second is a whole number of such ticks
    rig.hold()
    rig.torque.confirm_stop_begun()
    assert lowered(rig, SettleProfile(speed=0.01, way=8.0, within=0.5)) == (False, 0.5)


# --------------------------------------------------------------------------------------------- begun


def test_a_stop_counts_as_begun_when_the_goals_of_the_way_are_read_back(rig: ProcedureRig) -> None:
    lowered(rig)
    assert rig.torque.stop_begun
    assert rig.hardware.log == ["read goals"]


def test_a_stop_that_has_begun_is_not_confirmed_again(rig: ProcedureRig) -> None:
    rig.torque.confirm_stop_begun()
    lowered(rig)
    assert rig.hardware.log == []


def test_the_goals_are_read_back_two_ticks_after_the_way_began(rig: ProcedureRig) -> None:
    body = lower(rig, USUAL, rig.extended.append)
    next(body)
    body.send(0.0)
    assert rig.hardware.log == []
    body.send(0.0)
    assert rig.hardware.log == ["read goals"]


def test_devices_that_hold_other_goals_have_not_begun(rig: ProcedureRig) -> None:
    rig.hardware.obeyed = False
    done, _ = lowered(rig)
    assert done and not rig.torque.stop_begun


@pytest.mark.parametrize(("ticks", "begun"), [(5.9, True), (6.2, False)])
def test_a_device_may_be_six_ticks_behind(rig: ProcedureRig, ticks: float, begun: bool) -> None:
    lag = ticks * rig.robot.limits.velocity[0] * rig.robot.period + 0.001

    def behind() -> np.ndarray:
        return rig.robot.written + np.array([0.0, 0.0, -lag])

    rig.hardware.written = behind
    lowered(rig)
    assert rig.torque.stop_begun == begun


def test_a_device_at_exactly_six_ticks_has_begun(rig: ProcedureRig) -> None:
    lag = OBEYED * rig.robot.limits.velocity * rig.robot.period + rig.hardware.resolution
    body = lower(rig, USUAL, rig.extended.append)
    next(body)
    body.send(0.0)
    body.send(0.0)
    rig.robot.written = np.zeros(3)
    rig.hardware.written = lambda: -lag
    rig.hardware.serve()
    body.send(0.0)
    assert rig.torque.stop_begun


def test_joints_that_get_no_goals_are_not_looked_at(rig: ProcedureRig) -> None:
    rig.hardware.left_out = np.array([False, True, False])
    rig.hardware.written = lambda: np.where(rig.hardware.left_out, np.nan, rig.robot.written)
    lowered(rig)
    assert rig.torque.stop_begun


def test_goals_that_cannot_be_read_back_are_reported_and_the_way_goes_on(rig: ProcedureRig) -> None:
    rig.hardware.failing["read goals"] = BROKEN
    done, _ = lowered(rig)
    assert done and not rig.torque.stop_begun
    [event] = rig.book.events
    assert (event.level, event.code) == ("error", "BUS_ERRORS")
    assert event.message == "the goals of the way could not be read back: the bus is broken"


def test_without_a_goal_that_was_sent_nothing_has_begun(rig: ProcedureRig) -> None:
    body = lower(rig, USUAL, rig.extended.append)
    next(body)
    body.send(0.0)
    body.send(0.0)
    rig.robot.written = None
    rig.hardware.written = lambda: PLACE
    rig.hardware.serve()
    body.send(0.0)
    assert not rig.torque.stop_begun
