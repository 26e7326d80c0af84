"""The whole table of states x events x modes is walked, so that a new member cannot be forgotten."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.state_machine import LATCHED, TABLE, RobotEvent, StateLatch, mode_change, step

S = RobotState
E = RobotEvent
NO = None  # not allowed

# What every event does in every state. Columns in the order of `State`.
ORDER = (
    S.DISCONNECTED,
    S.IDENTIFYING,
    S.CONNECTED,
    S.CALIBRATING,
    S.ARMING,
    S.ARMED,
    S.SETTLING,
    S.FAULT,
    S.ESTOP,
    S.INHIBITED,
)
D, IDE, C, CAL, ARMING, ARMED, SET, F, EST, INH = ORDER
EXPECTED = {
    E.PORT_OPENED: (IDE, NO, NO, NO, NO, NO, NO, F, EST, NO),
    E.IDENTIFIED: (NO, C, NO, NO, NO, NO, NO, F, EST, NO),
    E.CALIBRATE: (NO, CAL, CAL, NO, NO, NO, NO, NO, NO, NO),
    E.CALIBRATED: (NO, NO, NO, C, NO, NO, NO, F, EST, NO),
    E.ARM: (NO, NO, ARMING, NO, NO, NO, NO, NO, NO, NO),
    E.ARMED: (NO, NO, NO, NO, ARMED, NO, NO, NO, NO, NO),
    E.ARM_FAILED: (D, IDE, C, NO, C, NO, SET, F, EST, INH),
    E.SETTLE: (NO, SET, SET, SET, SET, SET, SET, F, EST, NO),
    E.SETTLED: (D, IDE, C, NO, NO, NO, C, F, EST, INH),
    E.FAULT: (F, F, F, F, F, F, F, F, EST, INH),
    E.ESTOP: (EST, EST, EST, EST, EST, EST, EST, EST, EST, INH),
    E.RESET: (D, IDE, C, NO, NO, NO, NO, C, C, D),
    E.PORT_LOST: (D, D, D, D, D, D, D, D, D, D),
    E.INHIBIT: (INH, INH, INH, INH, INH, INH, INH, INH, INH, INH),
}


def test_the_table_here_names_every_state_and_every_event() -> None:
    assert tuple(RobotState) == ORDER
    assert set(EXPECTED) == set(RobotEvent) == set(TABLE)


@pytest.mark.parametrize("event", RobotEvent)
def test_each_event_has_its_documented_effect_in_every_state(event: RobotEvent) -> None:
    for state, after in zip(ORDER, EXPECTED[event], strict=True):
        if after is NO:
            with pytest.raises(RuntimeError) as refused:
                step(state, event)
            names = ", ".join(allowed.value for allowed in TABLE[event])
            reason = f"{event.value} is not possible while {state.value}; allowed while {names}"
            assert str(refused.value) == reason
        else:
            assert step(state, event) is after


@pytest.mark.parametrize("state", [state for state in RobotState if state is not RobotState.INHIBITED])
def test_e_stop_and_fault_are_never_refused(state: RobotState) -> None:
    assert step(state, RobotEvent.ESTOP) is RobotState.ESTOP
    assert step(state, RobotEvent.FAULT) in LATCHED


@pytest.mark.parametrize("state", [S.ARMING, S.ARMED, S.SETTLING, *LATCHED])
def test_torque_off_is_never_refused_where_there_is_torque(state: RobotState) -> None:
    assert step(state, RobotEvent.SETTLE) in (RobotState.SETTLING, *LATCHED)


# ---------------------------------------------------------------------------------------------- latch


def walk() -> set[StateLatch]:
    """Every latch that can ever be reached."""
    reached = set()
    open_ = {StateLatch()}
    while open_:
        latch = open_.pop()
        reached.add(latch)
        for event in RobotEvent:
            try:
                after = latch.after(event)
            except RuntimeError:
                continue
            if after not in reached:
                open_.add(after)
    return reached


def test_every_state_can_be_reached() -> None:
    assert {latch.state for latch in walk()} == set(RobotState)


def test_nothing_that_is_latched_is_armed_or_on_its_way_there() -> None:
    for latch in walk():
        if latch.latched:
            assert latch.state not in (S.CONNECTED, S.CALIBRATING, S.ARMING, S.ARMED, S.SETTLING)
        if latch.state in LATCHED:
            assert latch.latched


def test_only_a_known_bus_is_connected_or_armed() -> None:
    for latch in walk():
        if latch.state in (S.CONNECTED, S.ARMING, S.ARMED):  # anybody may be lowered, or have registers set
            assert latch.identified


@given(st.lists(st.sampled_from(RobotEvent), max_size=40))
def test_after_a_fault_or_an_e_stop_there_is_no_torque_without_reset_and_then_arm(
    events: list[RobotEvent],
) -> None:
    """X1, along any history."""
    latch = StateLatch()
    since_stop = [RobotEvent.RESET, RobotEvent.ARM]
    for event in events:
        try:
            latch = latch.after(event)
        except RuntimeError:
            continue
        since_stop = [] if event in (RobotEvent.FAULT, RobotEvent.ESTOP) else [*since_stop, event]
        if latch.state is RobotState.ARMED:
            assert RobotEvent.RESET in since_stop
            assert RobotEvent.ARM in since_stop[since_stop.index(RobotEvent.RESET) :]


def follow(*events: RobotEvent) -> StateLatch:
    latch = StateLatch()
    for event in events:
        latch = latch.after(event)
    return latch


def test_a_latch_outlives_a_lost_port() -> None:
    gone = follow(E.PORT_OPENED, E.IDENTIFIED, E.FAULT, E.PORT_LOST)
    assert (gone.state, gone.latched, gone.identified) == (S.DISCONNECTED, True, False)
    back = gone.after(E.PORT_OPENED).after(E.IDENTIFIED)
    assert back.state is S.FAULT
    assert back.after(E.RESET) == StateLatch(S.CONNECTED, False, True)


def test_a_reset_without_a_port_ends_disconnected() -> None:
    assert follow(E.ESTOP).state is S.ESTOP
    assert follow(E.ESTOP, E.RESET) == StateLatch()
    assert follow(E.PORT_OPENED, E.IDENTIFIED, E.ESTOP, E.RESET).state is S.CONNECTED


def test_an_e_stop_while_the_port_opens_is_kept_until_it_is_reset() -> None:
    latch = follow(E.ESTOP, E.PORT_OPENED, E.IDENTIFIED)
    assert latch == StateLatch(S.ESTOP, True, True)


def test_after_an_inhibit_the_bus_is_identified_anew() -> None:
    latch = follow(E.PORT_OPENED, E.IDENTIFIED, E.INHIBIT)
    assert (latch.state, latch.identified) == (S.INHIBITED, False)
    assert latch.after(E.RESET).state is S.DISCONNECTED
    assert latch.after(E.ESTOP) == StateLatch(S.INHIBITED, True, False)


# ----------------------------------------------------------------------------------------------- modes


@pytest.mark.parametrize(("before", "after"), list(product(Mode, Mode)))
def test_the_mode_changes_only_where_no_torque_is_lost_and_not_from_a_live_motion(
    before: Mode, after: Mode
) -> None:
    for state, motion in product(RobotState, Motion):
        finding = mode_change(before, after, state, motion)
        quiet = state in (S.DISCONNECTED, S.CONNECTED)
        # torque that was found on is switched off in live alone
        released = state in (*LATCHED, S.IDENTIFYING) and (before, after) == (Mode.MIRROR, Mode.LIVE)
        quiet = quiet or released
        allowed = before is after or (quiet and not (before is Mode.LIVE and motion is not Motion.IDLE))
        assert (finding is None) is allowed, (state, motion)
        if finding is not None:
            assert finding.code is ReasonCode.MODE_DENIES
            assert (state if not quiet else motion).value in finding.message


@pytest.mark.parametrize(
    ("state", "remedy"),
    [
        (S.FAULT, "reset"),
        (S.INHIBITED, "reset"),
        (S.ARMED, "disarm"),
        (S.ARMING, "disarm"),
        (S.CALIBRATING, "end the calibration"),
        (S.SETTLING, "wait"),
    ],
)
def test_a_refused_mode_change_names_the_remedy(state: RobotState, remedy: str) -> None:
    finding = mode_change(Mode.LIVE, Mode.SIM, state, Motion.IDLE)
    assert finding is not None
    assert remedy in finding.message


def test_a_latch_from_before_a_lost_port_refuses_a_calibration_as_a_fault_does() -> None:
    with pytest.raises(RuntimeError, match="while fault"):
        StateLatch(S.CONNECTED, latched=True).after(E.CALIBRATE)
