"""The pages safety, reason-codes and proof agree with the code: states, codes, thresholds, tests."""

import re

import pytest

from tests.support.daemon_rig import Rig
from tests.support.doc_pages_text import PROOF, REASON_CODES, ROOT, SAFETY, table
from twind.config import daemon_settings, travel
from twind.ctl.reasons import REASONS, write_reason_page
from twind.ctl.reasons.request_codes import REQUEST_CODES
from twind.ctl.reasons.runtime_codes import RUNTIME_CODES
from twind.front import front_server
from twind.loop.ipc import front_process
from twind.loop.procedures import arming, damping, failsafe, lowering
from twind.loop.tick import control_loop as tick
from twind.robot.finding import ReasonCode
from twind.robot.modes import RobotState
from twind.safety import gate, guard, latency_alarm, lease, plausibility_filter, setpoint_gate
from twind.safety.state_machine import TABLE, RobotEvent
from twind.twin import joint_range
from twind_drivers.dynamixel import damping as soft
from twind_drivers.half_duplex import soft_gain

# ----------------------------------------------------------------------------------------------- reason codes


def test_the_page_of_reason_codes_has_the_tables_of_the_code() -> None:
    command = "python -m twind.ctl.reasons.write_reason_page docs/reason-codes.md"
    assert write_reason_page.page_with_tables(REASON_CODES) == REASON_CODES, command


def test_a_page_without_a_place_for_the_tables_is_refused() -> None:
    with pytest.raises(ValueError, match="begin request codes"):
        write_reason_page.page_with_tables("# nothing")


def test_every_reason_code_has_one_row_with_effect_cause_and_remedy() -> None:
    found = re.findall(r"^\| `([A-Z_]+)` \| (.+) \| (.+) \| (.+) \|$", REASON_CODES, re.MULTILINE)
    assert sorted(code for code, *_ in found) == sorted(code.value for code in ReasonCode)
    assert not set(REQUEST_CODES) & set(RUNTIME_CODES)
    assert all(len(text.cause) > 15 and len(text.remedy) > 5 for text in REASONS.values())


def test_every_reason_code_is_raised_by_the_program() -> None:
    rooms = [path for path in (ROOT / "twind").rglob("*.py") if "reasons" not in path.parts]
    sources = "".join(path.read_text() for path in rooms if path.name != "finding.py")
    assert not [code.value for code in ReasonCode if not re.search(rf"Code\.{code.name}\b", sources)]


# ----------------------------------------------------------------------------------------------- states


def steps(cell: str) -> set[tuple[str, str]]:
    """`a`, `b` → `c`; `d` → `e`. `any` is every state but those named after it, and but the end itself."""
    found = set()
    for one in cell.split(";"):
        before, _, after = one.partition("→")
        end = after.strip().strip("`")
        named = set(re.findall(r"`(\w+)`", before))
        starts = (
            {state.value for state in RobotState} - named - {end}
            if before.strip().startswith("any")
            else named
        )
        found |= {(start, end) for start in starts}
    return found


def test_the_table_of_states_is_that_of_the_code() -> None:
    rows = {event: steps(cell) for event, _, cell in table(SAFETY, "event", "cause", "from → to")}
    assert set(rows) == {event.value for event in RobotEvent}
    for event, follows in TABLE.items():
        moves = {(start.value, end.value) for start, end in follows.items() if start is not end}
        assert rows[event.value] == moves, event


# ----------------------------------------------------------------------------------------------- numbers

GATE = gate.GateThresholds()
GUARD = guard.GuardThresholds()


def ms(seconds: float) -> str:
    return f"{seconds * 1e3:g} ms"


THRESHOLDS = {
    # requests
    "Trajectory: duration, points": f"at most {GATE.max_duration:g} s, {GATE.max_points}",
    "Trajectory: time between points": f"at least {ms(GATE.min_dt)}",
    "RATE_LIMIT: trajectories or `Mark` calls": f"{front_server.FrontServer.CALLS_PER_SECOND} per second",
    "START_JUMP": f"{GATE.start_jump:g} rad",
    "BRAKE_DISTANCE: allowed speed; margin": f"{GATE.brake_floor:g}; {GATE.brake_margin:g} rad/s",
    "END_NOT_AT_REST": f"{GATE.end_velocity:g} rad/s",
    "JERK_LIMIT": f"{GATE.jerk_warn:g} rad/s³",
    "Hard limit beyond the limit": f"{joint_range.BEYOND:g} rad",
    "LATENCY_WARN": ms(GATE.latency_warn),
    "LATENCY_BLOCK": ms(GATE.latency_block),
    "LATENCY_CALM": (
        f"below {latency_alarm.CALM * 100:g} % of the bound for more than {latency_alarm.CALM_FOR:g} s"
    ),
    "HW_DISCONNECTED: age": ms(GATE.stale),
    "THERMAL_HEADROOM, VOLTAGE_LOW: age": f"{GATE.health:g} s",
    "Lease; while streaming": f"{lease.TRAJECTORY:g} s; {lease.STREAMING:g} s",
    "STREAM_STALE: age of the setpoint": f"{GUARD.setpoint_age:g} s",
    "Setpoint `valid_for`": f"at most {setpoint_gate.LONGEST:g} s",
    # arming
    "Arming: age of a reading": ms(arming.FRESH),
    "Arming: jump at torque-on": f"{arming.JUMP:g} rad",
    "Turn: beyond the measured travel": f"{travel.ASTRAY:g} rad",
    # joints
    "STATE_STALE: warning": f"{ms(GUARD.stale_warn)}; 1.5 ticks below 50 Hz",
    "STATE_STALE: HOLD; fault": f"{ms(GUARD.stale_hold)}; {ms(GUARD.stale_fault)}",
    f"FOLLOW_ERR beyond {ms(GUARD.lag)} of the goal's speed: HOLD, fault": (
        f"`follow_rad` ({GUARD.follow:g} rad) for `follow_s` ({ms(GUARD.follow_for)})"
    ),
    "FOLLOW_ERR: DAMP": f"`follow_rad` + {GUARD.follow_damp - GUARD.follow:g} rad",
    "SENSE_FROZEN": f"{ms(GUARD.frozen_for)} and goal moved {GUARD.frozen_moved:g} rad while the servo "
    f"reports {GUARD.frozen_turning:g} rad/s; or goal moved {GUARD.frozen_far:g} rad at "
    f"{GUARD.frozen_load[0] * 100:g} to {GUARD.frozen_load[1] * 100:g} % load",
    "SENSE_JUMP": f"{plausibility_filter.REACH:g} × the motor's top speed × elapsed time "
    f"+ {plausibility_filter.TICKS:g} counts",
    "SENSE_JUMP: HOLD": f"{GUARD.jumps} in a row",
    "OUT_OF_LIMIT: beyond the hard limit": f"{GUARD.beyond_hard:g} rad",
    "OVERSPEED": f"{GUARD.overspeed:g} × limit + {GUARD.overspeed_slack:g} rad/s, "
    f"{GUARD.overspeed_row} readings",
    "OVERCURRENT: warning": f"{GUARD.load_warn * 100:g} % for {GUARD.load_warn_for:g} s",
    "OVERCURRENT: HOLD, fault; after twice that DAMP": (
        f"{GUARD.load_hold * 100:g} % for {GUARD.load_hold_for:g} s"
    ),
    "OVERCURRENT, I²t: warning; HOLD; SETTLE": (
        f"{GUARD.tired_warn:g} s; {GUARD.tired_hold:g} s; {GUARD.tired_settle:g} s"
    ),
    "OVERTEMP: single outlier, warning": f"{GUARD.spike:g} °C",
    "OVERTEMP: rise, warning": f"{GUARD.warming:g} °C/s over {GUARD.warming_over:g} s",
    "OVERTEMP: speed of a hot joint": f"{GUARD.hot_pace * 100:g} %",
    "OVERTEMP, VOLTAGE: not read, warning": f"{GUARD.unread:g} s",
    "LOOKAHEAD_COLLISION: slowest speed": f"{GUARD.least_pace * 100:g} %",
    "LEAD_LIMIT: slower; HOLD after waiting": (
        f"from {GUARD.lead_free * 100:g} % of `lead_limit_rad`; {GUARD.lead_for:g} s"
    ),
    "MIRROR_DRIFT": f"{GUARD.drift:g} rad for {GUARD.drift_for:g} s",
    # buses
    "BUS_ERRORS in 1 s: warning": f"{GUARD.errors_warn * 100:g} %",
    "BUS_ERRORS in 1 s: HOLD": f"{GUARD.errors_hold * 100:g} %, at least {GUARD.errors_least}",
    "BUS_ERRORS in a row: HOLD; fault": f"{GUARD.errors_row_hold}; {GUARD.errors_row_fault}",
    "FOREIGN_TRAFFIC in 1 s": f"{GUARD.foreign} packets",
    "TX_BACKLOG: fault": f"{GUARD.full} packets in a row",
    "CAN_BUS_STATE: all actuators silent": ms(GUARD.line_silent),
    "Servo watchdog": "100 ms",  # compared with the register below
    # loop
    "LOOP_LATE: tick late, warning": ms(GUARD.late),
    "LOOP_LATE: ticks missed in a row, warning": f"{GUARD.missed_warn}",
    "LOOP_LATE: HOLD": f"{GUARD.missed_hold} ticks and {ms(GUARD.missed_for)}",
    "TIME_GAP": ms(GUARD.gap),
    "INTERNAL: failed ticks in a row, INHIBIT": f"{tick.PATIENCE}",
    # stops
    "`support: free`: SETTLE after a HOLD": f"after {GUARD.hold_most:g} s",
    "Settling until torque off, else DAMP": f"{lowering.SETTLE:g} s",
    "At rest, `support: free`": f"{lowering.SLOW:g} rad/s for {lowering.SLOW_FOR:g} s, "
    f"within {lowering.NEAR:g} rad of the rest pose",
    "DAMP: at rest": f"{damping.SLOW:g} rad/s for {damping.SLOW_FOR:g} s, {damping.SLOW_MOST:g} s at most",
    "DAMP: PWM or current; P gain": f"{soft.SHARE * 100:g} %; 1/{soft_gain.SOFT}",
    # processes
    "Front process silent: restart": f"after {front_process.HEARTBEAT:g} s",
    "Fail-safe: wait for devices": f"{failsafe.WAIT:g} s",
    "Fail-safe: speed, planned duration, DAMP after": f"{failsafe.SPEED * 100:g} % of every limit, "
    f"{failsafe.WAY:g} s, {failsafe.WITHIN:g} s",
}


def test_every_threshold_of_the_page_is_that_of_the_code() -> None:
    assert dict(table(REASON_CODES, "what", "value")) == THRESHOLDS


def test_the_servo_watchdog_equals_the_documented_value(armed: Rig) -> None:
    assert set(armed.register("bus_watchdog").tolist()) == {5}  # x 20 ms


def test_the_formulas_of_the_page_are_those_of_the_gate() -> None:
    text = " ".join(REASON_CODES.split())
    assert f"max({GATE.brake_floor:g}, √(2·a·d) − {GATE.brake_margin:g}) rad/s" in text
    assert f"{GATE.start_jump:g} rad plus velocity limit × time of the first point" in text
    warn = daemon_settings.LATENCY_WARN_MS
    block = daemon_settings.LATENCY_BLOCK_MS
    assert (warn, block) == (GATE.latency_warn * 1e3, GATE.latency_block * 1e3)


def test_the_tests_that_prove_it_exist() -> None:
    named = [path for _, cell in table(PROOF, "claim", "tests") for path in re.findall(r"`([^`]+)`", cell)]
    assert len(named) > 12 and not [path for path in named if not (ROOT / path).is_file()]
