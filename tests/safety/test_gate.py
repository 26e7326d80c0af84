"""The gate at submit time: who may move what and when, in every mode and state, and every code it gives."""

from dataclasses import replace
from math import inf, nan, nextafter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.support import gate_rig as w
from tests.support.examples import examples
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.recovery_steps import UNKNOWN
from twind.robot.splines import interpolate
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.admission import admit, arming
from twind.safety.gate import TrajectoryRequest, check, checking

LATCHING = {
    RobotState.FAULT: ReasonCode.FAULT_LATCHED,
    RobotState.INHIBITED: ReasonCode.FAULT_LATCHED,
    RobotState.ESTOP: ReasonCode.ESTOP_LATCHED,
}
BOTH = np.ones(2, np.bool_)
MOVE = w.path([1.0, 2.0], [[0.2, 0.1], [0.3, 0.0]])


def codes(verdict: Verdict) -> list[ReasonCode]:
    return [finding.code for finding in verdict.refusals]


def judged(
    given: Trajectory = MOVE, demand: TrajectoryRequest | None = None, **over: object
) -> list[ReasonCode]:
    demand = demand or TrajectoryRequest()
    return codes(check(given, w.snapshot(2, **over), w.limits(), demand, w.TH).verdict)


# ------------------------------------------------------------------------------- modes × states


@pytest.mark.parametrize("motion", Motion)
@pytest.mark.parametrize("state", RobotState)
@pytest.mark.parametrize("mode", Mode)
def test_motion_needs_an_armed_robot_in_live_and_no_latch_anywhere(
    mode: Mode, state: RobotState, motion: Motion
) -> None:
    expected = [LATCHING[state]] if state in LATCHING else []
    if mode is Mode.LIVE and state is not RobotState.ARMED:
        expected.append(ReasonCode.NOT_ARMED)
    over = {"mode": mode, "state": state, "motion": motion}
    assert codes(admit(w.snapshot(**over), BOTH, w.TH)) == expected
    assert judged(**over) == expected


@pytest.mark.parametrize("state", RobotState)
@pytest.mark.parametrize("mode", Mode)
def test_arming_is_for_live_and_starts_from_connected(mode: Mode, state: RobotState) -> None:
    expected = [LATCHING[state]] if state in LATCHING else []
    if mode is not Mode.LIVE:
        expected.append(ReasonCode.MODE_DENIES)
    elif state is not RobotState.CONNECTED:
        expected.append(ReasonCode.ARM_FAILED)
    assert codes(arming(w.snapshot(mode=mode, state=state), w.TH)) == expected


@pytest.mark.parametrize("mode", Mode)
def test_every_motion_and_every_arming_needs_the_lease(mode: Mode) -> None:
    without = w.snapshot(mode=mode, lease_held=False)
    assert codes(admit(without, BOTH, w.TH)) == [ReasonCode.LEASE_MISSING]
    assert codes(arming(without, w.TH))[0] == ReasonCode.LEASE_MISSING


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize(
    ("latched", "expected"),
    [
        ((ReasonCode.ESTOP,), [ReasonCode.ESTOP_LATCHED]),
        ((ReasonCode.ESTOP_LATCHED,), [ReasonCode.ESTOP_LATCHED]),
        ((ReasonCode.SERVO_ALERT,), [ReasonCode.FAULT_LATCHED]),
        (
            (ReasonCode.TORQUE_MISMATCH, ReasonCode.ESTOP),
            [ReasonCode.ESTOP_LATCHED, ReasonCode.FAULT_LATCHED],
        ),
    ],
)
def test_latches_refuse_in_every_mode(
    mode: Mode, latched: tuple[ReasonCode, ...], expected: list[ReasonCode]
) -> None:
    verdict = admit(w.snapshot(mode=mode, latched=latched), BOTH, w.TH)
    assert codes(verdict) == expected
    if ReasonCode.SERVO_ALERT in latched:
        assert "SERVO_ALERT" in verdict.refusals[0].message


MENDED = ", then find and mend the cause, then `twindctl reset`"


@pytest.mark.parametrize(
    ("latched", "over", "message"),
    [
        (
            (ReasonCode.FALLING,),
            {"torque_on": True},
            f"FALLING (the robot fell); torque is on; next: `twindctl disarm`{MENDED}, "
            "then set it on its feet, then `twindctl arm`",
        ),
        (
            (ReasonCode.FOLLOW_ERR,),
            {"torque_on": False},
            "FOLLOW_ERR; torque is off; next: find and mend the cause, then `twindctl reset`, "
            "then `twindctl arm`",
        ),
        (
            (ReasonCode.PORT_LOST,),
            {"state": RobotState.DISCONNECTED},
            f"PORT_LOST; {UNKNOWN}; next: `twindctl disarm`{MENDED}, then `twindctl arm`",
        ),
        (
            (ReasonCode.INTERNAL, ReasonCode.WATCHDOG_TRIPPED),
            {"state": RobotState.INHIBITED, "torque_on": True},
            "INTERNAL, WATCHDOG_TRIPPED; torque is on; next: support the robot, then `twindctl disarm`"
            f"{MENDED}, then `twindctl arm`",
        ),
        (
            (ReasonCode.INTERNAL,),
            {"state": RobotState.INHIBITED},
            f"INTERNAL; {UNKNOWN}; next: support the robot, then `twindctl disarm`{MENDED}, "
            "then `twindctl arm`",
        ),
        (
            (ReasonCode.ESTOP,),
            {"state": RobotState.ESTOP, "torque_on": True},
            f"an e-stop is latched; torque is on; next: wait until torque is off{MENDED}, "
            "then `twindctl arm`",
        ),
        (
            (ReasonCode.ESTOP,),
            {"mode": Mode.SIM},
            f"an e-stop is latched; next: {MENDED.removeprefix(', then ')}",
        ),
    ],
)
def test_a_latch_is_refused_with_what_happened_and_the_next_commands(
    latched: tuple[ReasonCode, ...], over: dict[str, object], message: str
) -> None:
    given = w.snapshot(**{"state": RobotState.FAULT, "latched": latched, **over})
    assert admit(given, BOTH, w.TH).refusals[0].message == message
    assert arming(given, w.TH).refusals[0].message == message


@pytest.mark.parametrize("mode", Mode)
def test_no_motion_and_no_arming_begins_while_no_client_can_connect(mode: Mode) -> None:
    gone = Finding(ReasonCode.SOCKETS_GONE, message="removed")
    verdict = admit(w.snapshot(mode=mode, unreachable=gone), BOTH, w.TH)
    assert verdict.refusals == (gone,)
    stream = admit(
        w.snapshot(mode=mode, unreachable=gone, motion=Motion.STREAMING), BOTH, w.TH, setpoint=True
    )
    assert stream.refusals == (gone,)
    state = RobotState.CONNECTED if mode is Mode.LIVE else RobotState.DISCONNECTED
    assert gone in arming(w.snapshot(mode=mode, state=state, unreachable=gone), w.TH).refusals


# ------------------------------------------------------------------------------- the hardware


HARDWARE = {
    "calibrated": (np.array([True, False]), [ReasonCode.CALIB_MISSING]),
    "mismatches": ((Finding(ReasonCode.CALIB_MISMATCH, joint=0),), [ReasonCode.CALIB_MISMATCH]),
    "age": (np.array([0.004, 0.2]), [ReasonCode.HW_DISCONNECTED]),
    "latency": (0.11, [ReasonCode.LATENCY_BLOCK]),
    "latency_p95": (nan, [ReasonCode.LATENCY_BLOCK]),
}


@pytest.mark.parametrize("field", HARDWARE)
def test_the_hardware_counts_in_live_only(field: str) -> None:
    value, expected = HARDWARE[field]
    assert codes(admit(w.snapshot(**{field: value}), BOTH, w.TH)) == expected
    connected = w.snapshot(state=RobotState.CONNECTED, **{field: value})
    assert codes(arming(connected, w.TH)) == expected
    for mode in (Mode.SIM, Mode.MIRROR):
        assert judged(mode=mode, **{field: value}) == []


def test_only_moving_joints_must_be_calibrated_and_fresh_but_all_of_them_to_arm_some() -> None:
    ill = {"calibrated": np.array([True, False]), "age": np.array([0.0, inf])}
    first = np.array([True, False])
    assert admit(w.snapshot(**ill), first, w.TH).accepted
    findings = arming(w.snapshot(state=RobotState.CONNECTED, **ill), w.TH, first).refusals
    assert [(f.code, f.joint) for f in findings] == [
        (ReasonCode.CALIB_MISSING, 1),
        (ReasonCode.HW_DISCONNECTED, 1),
    ]


def test_arming_no_joint_is_refused() -> None:
    nobody = np.zeros(2, np.bool_)
    assert codes(arming(w.snapshot(state=RobotState.CONNECTED), w.TH, nobody)) == [ReasonCode.NO_JOINTS]


@pytest.mark.parametrize(
    ("age", "passes"),
    [(0.0, True), (0.1, True), (nextafter(0.1, 1.0), False), (-1e-300, False), (nan, False), (inf, False)],
)
def test_an_age_is_fresh_up_to_its_bound_and_unknown_is_old(age: float, passes: bool) -> None:
    verdict = admit(w.snapshot(age=np.array([0.0, age])), BOTH, w.TH)
    assert verdict.accepted is passes
    if not passes:
        assert (verdict.refusals[0].joint, verdict.refusals[0].bound) == (1, 0.1)


@pytest.mark.parametrize("field", ["latency", "latency_p95"])
@pytest.mark.parametrize(
    ("value", "passes", "warns"),
    [
        (0.0, True, False),
        (0.05, True, False),
        (nextafter(0.05, 1.0), True, True),
        (0.1, True, True),
        (nextafter(0.1, 1.0), False, False),
        (-1e-9, False, False),
        (nan, False, False),
        (inf, False, False),
    ],
)
def test_latency_warns_then_blocks_and_unknown_blocks(
    field: str, value: float, passes: bool, warns: bool
) -> None:
    verdict = admit(w.snapshot(**{field: value}), BOTH, w.TH)
    assert verdict.accepted is passes
    assert bool(verdict.warnings) is warns
    assert {f.code for f in verdict.warnings} <= {ReasonCode.LATENCY_WARN}
    assert set(codes(verdict)) <= {ReasonCode.LATENCY_BLOCK}
    assert arming(w.snapshot(state=RobotState.CONNECTED, **{field: value}), w.TH).accepted is passes


# ------------------------------------------------------------------------------- the demand


@pytest.mark.parametrize(
    ("start_in", "expected"),
    [
        (0.0, []),
        (60.0, []),
        (nextafter(60.0, 61.0), [ReasonCode.TOO_DISTANT]),
        (inf, [ReasonCode.TOO_DISTANT]),
        (-1e-300, [ReasonCode.CMD_EXPIRED]),
        (nan, [ReasonCode.CMD_EXPIRED]),
    ],
)
def test_a_start_must_be_between_now_and_a_minute(start_in: float, expected: list[ReasonCode]) -> None:
    assert judged(demand=TrajectoryRequest(start_in=start_in)) == expected


def test_an_unknown_policy_is_refused() -> None:
    assert judged(demand=TrajectoryRequest(policy="clamp")) == [ReasonCode.BAD_SCHEMA]


def test_a_full_queue_is_busy() -> None:
    assert judged(busy=True) == [ReasonCode.BUSY]
    assert judged(replace(MOVE, time=MOVE.time * np.nan), busy=True)[-1] == ReasonCode.BUSY


# ------------------------------------------------------------------------------- start and end


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_first_point_must_be_near_the_reference(sign: float) -> None:
    for jump, passes in ((0.05, True), (nextafter(0.05, 0.0), True), (nextafter(0.05, 1.0), False)):
        verdict = w.ask(w.path([0.0], [sign * jump]), w.limits(1), w.at_rest([0.0])).verdict
        assert verdict.accepted is passes
    (finding,) = verdict.refusals
    assert (finding.code, finding.point, finding.time, finding.bound) == (ReasonCode.START_JUMP, 0, 0.0, 0.05)
    assert finding.value == nextafter(0.05, 1.0)


def test_a_later_first_point_may_be_as_far_as_the_velocity_limit_reaches() -> None:
    far = w.ask(w.path([0.2], [0.9]), w.limits(1), w.at_rest([0.0]))
    assert ReasonCode.START_JUMP in w.codes(far)
    near = w.ask(w.path([0.2], [0.8]), w.limits(1), w.at_rest([0.0]))
    assert ReasonCode.START_JUMP not in w.codes(near)


@pytest.mark.parametrize("part", ["position", "velocity", "acceleration"])
@pytest.mark.parametrize("value", [nan, inf])
def test_an_unknown_reference_refuses_and_the_rest_of_the_path_is_judged(part: str, value: float) -> None:
    before = replace(w.at_rest([0.2, 0.1]), **{part: np.array([0.0, value])})
    verdict = w.ask(w.path([1.0, 50.0], [[0.2, 0.1], [2.01, 0.0]]), w.limits(), before).verdict
    assert [(f.code, f.joint) for f in verdict.refusals] == [
        (ReasonCode.POS_LIMIT, 0),
        (ReasonCode.START_JUMP, 1),
    ]
    assert "unknown" in verdict.refusals[1].message


def test_the_end_is_at_rest_or_refused() -> None:
    for v, passes in ((0.05, True), (-0.05, True), (nextafter(0.05, 1.0), False), (-0.06, False)):
        path = w.path([1.0, 2.0], [0.0, 0.01], [0.0, v])
        verdict = w.ask(path, w.limits(1), w.at_rest([0.0])).verdict
        assert verdict.accepted is passes
    (finding,) = verdict.refusals
    assert (finding.code, finding.point, finding.time, finding.value) == (
        ReasonCode.END_NOT_AT_REST,
        1,
        2.0,
        0.06,
    )


# ------------------------------------------------------------------------------- the whole


def test_all_failing_codes_are_returned_in_the_order_of_the_rules() -> None:
    path = w.path([0.0, 0.5, 1.0], [[0.3, 0.0], [2.5, 0.0], [0.0, 0.0]], [[0.0, 0.0], [8.0, 0.0], [5.0, 0.0]])
    over = {
        "lease_held": False,
        "latched": (ReasonCode.ESTOP, ReasonCode.SERVO_ALERT),
        "state": RobotState.CONNECTED,
        "calibrated": np.array([False, True]),
        "age": np.array([inf, 0.0]),
        "latency": nan,
        "busy": True,
    }
    snapshot = w.snapshot(2, **over)
    verdict = check(path, snapshot, w.limits(), TrajectoryRequest(start_in=nan), w.TH).verdict
    assert list(dict.fromkeys(codes(verdict))) == [
        ReasonCode.LEASE_MISSING,
        ReasonCode.ESTOP_LATCHED,
        ReasonCode.FAULT_LATCHED,
        ReasonCode.NOT_ARMED,
        ReasonCode.CALIB_MISSING,
        ReasonCode.HW_DISCONNECTED,
        ReasonCode.LATENCY_BLOCK,
        ReasonCode.CMD_EXPIRED,
        ReasonCode.POS_LIMIT,
        ReasonCode.START_JUMP,
        ReasonCode.VEL_LIMIT,
        ReasonCode.ACC_LIMIT,
        ReasonCode.BRAKE_DISTANCE,
        ReasonCode.END_NOT_AT_REST,
        ReasonCode.BUSY,
    ]


REACHED = {
    ReasonCode.EMPTY: (Trajectory(np.zeros(0), np.zeros((0, 2)), BOTH), TrajectoryRequest()),
    ReasonCode.NO_JOINTS: (replace(MOVE, commanded=~BOTH), TrajectoryRequest()),
    ReasonCode.BAD_SHAPE: (replace(MOVE, position=np.zeros((2, 3))), TrajectoryRequest()),
    ReasonCode.TOO_MANY_POINTS: (
        w.path(list(np.arange(2001) * 0.01), np.zeros((2001, 2))),
        TrajectoryRequest(),
    ),
    ReasonCode.NONFINITE: (w.path([1.0], [[0.0, nan]]), TrajectoryRequest()),
    ReasonCode.TIME_ORDER: (w.path([1.0, 1.0], [[0.0, 0.0], [0.0, 0.0]]), TrajectoryRequest()),
}


@pytest.mark.parametrize("code", REACHED)
def test_each_code_of_the_form_is_reached_alone(code: ReasonCode) -> None:
    path, demand = REACHED[code]
    assert judged(path, demand) == [code]


def test_an_accepted_path_comes_with_the_curve_it_was_judged_by() -> None:
    snapshot = w.snapshot(2, reference=w.at_rest([0.1, 0.0]))
    result = check(MOVE, snapshot, w.limits(), TrajectoryRequest(), w.TH)
    expected = interpolate(MOVE, snapshot.reference)
    assert result.verdict == Verdict()
    assert result.path is MOVE
    assert np.array_equal(result.spline.coefficients, expected.coefficients)
    assert np.array_equal(result.spline.time, expected.time)


def test_a_path_without_form_comes_with_a_curve_that_stays() -> None:
    result = check(
        REACHED[ReasonCode.EMPTY][0],
        w.snapshot(2, reference=w.at_rest([0.3, 0.4])),
        w.limits(),
        TrajectoryRequest(),
        w.TH,
    )
    assert result.spline.duration == 0.0
    assert list(result.spline.sample(5.0).position) == [0.3, 0.4]


def test_the_check_pauses_between_slices_and_only_there() -> None:
    def pauses(k: int, rates: int = 0, demand: TrajectoryRequest | None = None, size: float = 0.0) -> int:
        zeros = np.zeros((k, 2))
        given = [zeros if rates > i else None for i in range(2)]
        path = w.path(list(np.arange(1, k + 1) * 0.01), zeros + size, *given)
        return len(
            list(
                checking(
                    path, w.snapshot(2), w.limits(), demand or TrajectoryRequest(), w.TH, points_per_step=500
                )
            )
        )

    assert [pauses(k) for k in (1, 500, 501, 1000, 1200)] == [0, 0, 1, 1, 2]
    assert [pauses(1200, rates) for rates in (1, 2)] == [2, 2]
    retime = TrajectoryRequest("retime")
    assert pauses(100, 0, retime, 0.05) == 0  # judged twice, still within one slice
    assert pauses(400, 0, retime, 0.05) == 1


def test_the_same_question_gets_the_same_answer_and_nothing_is_written_to() -> None:
    path = w.path([0.0, 0.5, 1.0], [[0.3, 0.0], [2.5, 0.0], [0.0, 0.0]], [[0.0, 0.0], [8.0, 0.0], [5.0, 0.0]])
    snapshot = w.snapshot(2)
    limits = w.limits()
    for array in (path.time, path.position, path.velocity, path.commanded, snapshot.age, limits.upper):
        array.setflags(write=False)
    answers = [
        check(path, snapshot, limits, TrajectoryRequest("retime", True), w.TH).verdict for _ in range(2)
    ]
    assert answers[0] == answers[1]


@examples(60)
@given(w.paths(joints=2), w.REFERENCES)
def test_the_order_of_joints_changes_nothing(path: Trajectory, before: Reference) -> None:
    def turned(rows: np.ndarray | None) -> np.ndarray | None:
        return None if rows is None else rows[..., ::-1].copy()

    limit = w.limits(lower=np.array([-0.5, -1.0]), velocity=np.array([1.0, 3.0]))
    mirror = replace(limit, **{name: turned(getattr(limit, name)) for name in limit.__slots__})
    other = replace(
        path,
        position=turned(path.position),
        velocity=turned(path.velocity),
        acceleration=turned(path.acceleration),
    )
    after = Reference(turned(before.position), turned(before.velocity), turned(before.acceleration))
    one = {(f.code, f.joint) for f in w.ask(path, limit, before).verdict.refusals}
    two = {(f.code, 1 - f.joint) for f in w.ask(other, mirror, after).verdict.refusals}
    assert one == two


ANY = st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from((0.0, nan, inf, -inf, 1e308, 5e-324))
SHAPES = st.sampled_from(((0,), (3,), (2,), (0, 2), (2, 2), (3, 2), (3, 3), (2, 3, 2), ()))


def arrays(shape: object = SHAPES) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float64, shape, elements=ANY)


WILD = st.builds(
    Trajectory,
    time=arrays(),
    position=arrays(),
    commanded=hnp.arrays(np.bool_, SHAPES),
    velocity=st.none() | arrays(),
    acceleration=st.none() | arrays(),
)
SHAPED = st.tuples(st.integers(0, 2), st.booleans()).flatmap(
    lambda kind: st.builds(
        Trajectory,
        time=st.lists(st.floats(0.0, 30.0), min_size=3, max_size=3).map(sorted).map(np.array) | arrays((3,)),
        position=arrays((3, 2)) | st.just(np.zeros((3, 2))),
        commanded=hnp.arrays(np.bool_, (2,)),
        velocity=arrays((3, 2)) if kind[0] else st.none(),
        acceleration=arrays((3, 2)) if kind[0] > 1 else st.none(),
    )
)


@examples(200)
@given(
    WILD | SHAPED | SHAPED,
    st.builds(Reference, arrays((2,)), arrays((2,)), arrays((2,))),
    st.sampled_from(("reject", "retime", "")),
    st.booleans(),
    ANY,
)
def test_any_numbers_get_a_verdict_and_never_an_exception(
    path: Trajectory, before: Reference, policy: str, stop: bool, start_in: float
) -> None:
    snapshot = w.snapshot(2, reference=before, latency=start_in, age=before.position)
    result = check(path, snapshot, w.limits(), TrajectoryRequest(policy, stop, start_in), w.TH)
    for finding in result.verdict.refusals:
        assert finding.joint is None or 0 <= finding.joint < 2
    if result.verdict.accepted:
        final = result.path
        assert np.isfinite(final.position[:, final.commanded]).all()
        assert (np.diff(final.time) > 0.0).all()
        assert (np.abs(final.position[:, final.commanded]) <= 2.0).all()


FAST = w.path([1.0, 1.1], [[0.0, 0.0], [0.7, 0.1]])  # 7 rad/s on the way, at most 4


def test_a_refusal_for_speed_names_the_time_with_which_the_path_passes() -> None:
    refusals = check(FAST, w.snapshot(2), w.limits(), TrajectoryRequest(), w.TH).verdict.refusals
    text = refusals[0].message
    seconds = float(text.rpartition("needs ")[2].removesuffix(" s"))
    assert text.endswith(f"the whole path needs {seconds:.2f} s")
    assert judged(FAST.stretched(seconds / 1.1)) == []
    assert judged(FAST.stretched((seconds - 0.02) / 1.1)) != []


def test_a_refusal_names_no_time_where_more_time_would_not_do() -> None:
    moving = Reference(np.zeros(2), np.array([0.5, 0.0]), np.zeros(2))
    beyond = w.path([1.0, 1.1], [[0.0, 0.0], [2.5, 0.1]])
    for path, over in ((FAST, {"reference": moving}), (beyond, {})):
        refusals = check(path, w.snapshot(2, **over), w.limits(), TrajectoryRequest(), w.TH).verdict.refusals
        assert refusals
        assert not any("needs" in each.message for each in refusals)
