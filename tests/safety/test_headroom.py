"""THERMAL_HEADROOM: temperature and supply, dense around their bounds; never read, old, and unknown."""

from dataclasses import replace
from math import inf, nan, nextafter

import numpy as np
import pytest

from tests.support import gate_rig as w
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.admission import admit, arming
from twind.safety.gate import TrajectoryRequest, check
from twind.safety.headroom import JointCondition, headroom

BOTH = np.ones(2, np.bool_)
HEADROOM = (ReasonCode.THERMAL_HEADROOM, ReasonCode.VOLTAGE_LOW)


def second(usual: float, value: float) -> np.ndarray:
    return np.array([usual, value])


def refused(
    condition: JointCondition | None, chosen: np.ndarray = BOTH
) -> list[tuple[ReasonCode, int | None]]:
    """By arming and by a motion alike."""
    armed = w.snapshot(condition=condition)
    connected = w.snapshot(state=RobotState.CONNECTED, condition=condition)
    found = [(finding.code, finding.joint) for finding in admit(armed, chosen, w.TH).refusals]
    assert found == [(finding.code, finding.joint) for finding in arming(connected, w.TH, chosen).refusals]
    return found


@pytest.mark.parametrize(
    ("celsius", "fine"),
    [(64.9, True), (65.0, True), (nextafter(65.0, inf), False), (80.0, False), (nan, False), (inf, False)],
)
def test_too_hot_to_begin(celsius: float, fine: bool) -> None:
    assert refused(w.condition(temperature=second(35.0, celsius))) == (
        [] if fine else [(ReasonCode.THERMAL_HEADROOM, 1)]
    )


@pytest.mark.parametrize(
    ("volts", "fine"),
    [(10.6, True), (nextafter(10.5, inf), True), (10.5, False), (9.0, False), (nan, False), (-inf, False)],
)
def test_too_low_to_begin(volts: float, fine: bool) -> None:
    assert refused(w.condition(voltage=second(12.0, volts))) == (
        [] if fine else [(ReasonCode.VOLTAGE_LOW, 1)]
    )


@pytest.mark.parametrize(
    ("age", "fine"),
    [(0.0, True), (1.0, True), (nextafter(1.0, inf), False), (inf, False), (-0.1, False), (nan, False)],
)
def test_a_reading_that_is_old_or_of_no_age_refuses(age: float, fine: bool) -> None:
    expected = [] if fine else [(code, 1) for code in HEADROOM]
    assert refused(w.condition(age=second(0.1, age))) == expected


def test_a_joint_moves_with_all_the_motors_that_turn_it() -> None:
    hot = w.condition(temperature=second(35.0, 90.0))
    first = np.array([True, False])
    pair = replace(hot, together=(np.array([0, 1]),))
    assert refused(hot, first) == []
    assert refused(pair, first) == [(ReasonCode.THERMAL_HEADROOM, 1)]
    assert refused(replace(hot, together=(np.array([1]),)), first) == []


def test_only_the_joints_that_move_count() -> None:
    hot = w.condition(temperature=second(35.0, 90.0), voltage=second(12.0, 5.0))
    assert refused(hot, np.array([True, False])) == []
    assert refused(hot, np.array([False, True])) == [(code, 1) for code in HEADROOM]


def test_nothing_known_of_it_refuses() -> None:
    assert [code for code, _ in refused(None)] == list(HEADROOM)


def test_a_model_of_which_no_bounds_are_known_is_not_barred() -> None:
    unknown = w.condition(temperature=np.full(2, nan), voltage=np.full(2, nan), age=np.full(2, inf))
    assert refused(replace(unknown, ratings=ActuatorRatings.unknown(2))) == []


def test_a_headroom_finding_gives_value_bound_and_cause() -> None:
    told = headroom(w.condition(temperature=second(35.0, 70.0)), BOTH, 1.0)
    assert [(f.joint, f.value, f.bound) for f in told] == [(1, 70.0, 65.0)] and "too hot" in told[0].message
    never = headroom(w.condition(age=second(0.1, inf), voltage=second(12.0, nan)), BOTH, 1.0)
    assert all("not read yet" in f.message for f in never)
    old = headroom(w.condition(age=second(0.1, 3.0)), BOTH, 1.0)
    assert [f.message.partition(";")[0] for f in old] == [
        "not read lately: 35 °C was 3 s ago",
        "not read lately: 12 V was 3 s ago",
    ]
    assert all(f.value is None and f.bound is None for f in old)  # good numbers are no reason


@pytest.mark.parametrize("mode", [Mode.SIM, Mode.MIRROR])
def test_headroom_is_checked_only_in_live(mode: Mode) -> None:
    assert admit(w.snapshot(mode=mode, condition=None), BOTH, w.TH).accepted


def test_a_stream_that_runs_is_not_cut_off_by_it() -> None:
    hot = w.condition(temperature=second(35.0, 90.0))
    assert admit(w.snapshot(motion=Motion.STREAMING, condition=hot), BOTH, w.TH, setpoint=True).accepted
    for motion in (Motion.IDLE, Motion.HOLDING, Motion.ACTIVE):
        assert not admit(w.snapshot(motion=motion, condition=hot), BOTH, w.TH, setpoint=True).accepted


def test_a_trajectory_that_would_end_a_stream_is_refused_with_it() -> None:
    hot = w.snapshot(motion=Motion.STREAMING, condition=w.condition(temperature=second(35.0, 90.0)))
    assert not admit(hot, BOTH, w.TH).accepted
    verdict = check(
        w.path([1.0, 2.0], [[0.2, 0.1], [0.3, 0.0]]), hot, w.limits(), TrajectoryRequest(), w.TH
    ).verdict
    assert ReasonCode.THERMAL_HEADROOM in [finding.code for finding in verdict.refusals]


def test_a_trajectory_is_refused_with_it() -> None:
    path = w.path([1.0, 2.0], [[0.2, 0.1], [0.3, 0.0]])
    cold = w.snapshot(condition=w.condition(voltage=second(12.0, 10.0)))
    verdict = check(path, cold, w.limits(), TrajectoryRequest(), w.TH).verdict
    assert [finding.code for finding in verdict.refusals] == [ReasonCode.VOLTAGE_LOW]


@pytest.mark.parametrize(("age", "last"), [(3.0, 12.0), (inf, nan)])
def test_a_silent_joint_is_refused_once_not_also_for_its_old_temperature(age: float, last: float) -> None:
    quiet = w.condition(
        age=second(0.1, age), temperature=second(35.0, 2.0 * last), voltage=second(12.0, last)
    )
    silent = second(0.0, inf)
    armed = w.snapshot(condition=quiet, age=silent)
    connected = w.snapshot(state=RobotState.CONNECTED, condition=quiet, age=silent)
    for verdict in (admit(armed, BOTH, w.TH), arming(connected, w.TH, BOTH)):
        assert [(each.code, each.joint) for each in verdict.refusals] == [(ReasonCode.HW_DISCONNECTED, 1)]
    hot = w.snapshot(condition=w.condition(temperature=second(35.0, 90.0)), age=silent)
    assert ReasonCode.THERMAL_HEADROOM in {each.code for each in admit(hot, BOTH, w.TH).refusals}
