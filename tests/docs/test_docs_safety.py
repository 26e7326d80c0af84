"""The pages safety, reason-codes and proof agree with the code: states, codes, thresholds, tests."""

import re

import pytest

from tests.support.daemon_rig import Rig
from tests.support.doc_pages_text import PROOF, REASON_CODES, ROOT, SAFETY, table
from twind import cli
from twind.config import daemon_settings
from twind.ctl import estop
from twind.ctl.reasons import REASONS, reason_page
from twind.ctl.reasons.request_codes import REQUEST_CODES
from twind.ctl.reasons.runtime_codes import RUNTIME_CODES
from twind.front import front_server
from twind.loop import (
    arming,
    bus_port,
    damping,
    failsafe,
    front_process,
    submission_tracker,
    tick,
    torque_release,
)
from twind.robot.finding import ReasonCode
from twind.robot.modes import RobotState
from twind.safety import gate, guard, latency_alarm, lease, plausibility_filter, setpoint_gate
from twind.safety.state_machine import TABLE, RobotEvent
from twind.telemetry import command_latency, timing_monitor
from twind.twin import binding, joint_range
from twind_drivers.dynamixel import damping as soft
from twind_drivers.dynamixel import serial_cycle_budget

# ----------------------------------------------------------------------------------------------- reason codes


def test_the_page_of_reason_codes_has_the_tables_of_the_code() -> None:
    command = "python -m twind.ctl.reasons.reason_page docs/reason-codes.md"
    assert reason_page.page_with_tables(REASON_CODES) == REASON_CODES, command


def test_a_page_without_a_place_for_the_tables_is_refused() -> None:
    with pytest.raises(ValueError, match="begin request codes"):
        reason_page.page_with_tables("# nothing")


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


def unit(key: str, name: str = "twind.service") -> str:
    """A number of a unit."""
    found = re.search(rf"^{key}=(\d+)$", (ROOT / "systemd" / name).read_text(), re.MULTILINE)
    assert found
    return f"{found[1]} s"


THRESHOLDS = {
    # requests
    "Trajectory: duration, points": f"at most {GATE.max_duration:g} s, {GATE.max_points}",
    "Trajectory points: distance": f"at least {ms(GATE.min_dt)}",
    "Trajectories or `Mark` calls of one process": f"{front_server.FrontServer.CALLS_PER_SECOND} per second",
    "START_JUMP: distance of the first point": f"{GATE.start_jump:g} rad",
    "BRAKE_DISTANCE: speed always allowed; margin": f"{GATE.brake_floor:g}; {GATE.brake_margin:g} rad/s",
    "END_NOT_AT_REST: speed": f"{GATE.end_velocity:g} rad/s",
    "JERK_LIMIT": f"{GATE.jerk_warn:g} rad/s³",
    "Hard limit beyond the robot file's limit": f"{joint_range.BEYOND:g} rad",
    "LATENCY_WARN (state age + bus round trip)": ms(GATE.latency_warn),
    "LATENCY_BLOCK": ms(GATE.latency_block),
    "LATENCY_WARN of one hop": f"{timing_monitor.LATENCY * 1e3:g} ms",
    "LATENCY_CALM": (
        f"below {latency_alarm.CALM * 100:g} % of the bound for more than {latency_alarm.CALM_FOR:g} s"
    ),
    "Hop `moved`: visible motion of a resting joint": f"{command_latency.VISIBLE:g} rad",
    "HW_DISCONNECTED: age of a reading": ms(GATE.stale),
    "THERMAL_HEADROOM, VOLTAGE_LOW: age of a reading": f"{GATE.health:g} s",
    "Clearance verdict: age": f"at most {submission_tracker.STALE_VERDICT:g} s",
    "Points checked per tick": f"{submission_tracker.SLICE}",
    "Lease; while streaming": f"{lease.TRAJECTORY:g} s; {lease.STREAMING:g} s",
    "STREAM_STALE: age of the newest setpoint": f"{GUARD.setpoint_age:g} s",
    "Setpoint `valid_for`": f"at most {setpoint_gate.LONGEST:g} s",
    # arming
    "Arming: age of a reading": ms(arming.FRESH),
    "Arming: wait for temperature and supply": f"{arming.FIRST:g} s",
    "Arming: joint still moves": f"{arming.STILL:g} encoder counts, {arming.TRIES} tries",
    "Arming: jump at torque-on": f"{arming.JUMP:g} rad",
    "Turn: distance beyond the measured travel": f"{binding.ASTRAY:g} rad",
    # joints
    "STATE_STALE: warning": f"{ms(GUARD.stale_warn)}; 1.5 ticks below 50 Hz",
    "STATE_STALE: HOLD; fault": f"{ms(GUARD.stale_hold)}; {ms(GUARD.stale_fault)}",
    f"FOLLOW_ERR beyond {ms(GUARD.lag)} of the goal's speed: HOLD, fault": (
        f"{GUARD.follow:g} rad for {ms(GUARD.follow_for)}"
    ),
    "FOLLOW_ERR: DAMP": f"{GUARD.follow_damp:g} rad",
    "SENSE_FROZEN": f"{ms(GUARD.frozen_for)} and goal moved {GUARD.frozen_moved:g} rad while the servo "
    f"reports {GUARD.frozen_turning:g} rad/s; or goal moved {GUARD.frozen_far:g} rad at "
    f"{GUARD.frozen_load[0] * 100:g} to {GUARD.frozen_load[1] * 100:g} % load",
    "SENSE_JUMP: distance": f"{plausibility_filter.REACH:g} × the motor's top speed × elapsed time "
    f"+ {plausibility_filter.TICKS:g} counts",
    "SENSE_JUMP: HOLD": f"{GUARD.jumps} in a row",
    "OUT_OF_LIMIT: beyond the hard limit": f"{GUARD.beyond_hard:g} rad",
    "OVERSPEED": f"{GUARD.overspeed:g} × limit + {GUARD.overspeed_slack:g} rad/s, "
    f"{GUARD.overspeed_row} readings",
    "OVERCURRENT: warning": f"{GUARD.load_warn * 100:g} % for {GUARD.load_warn_for:g} s",
    "OVERCURRENT: HOLD, fault; after twice that DAMP": (
        f"{GUARD.load_hold * 100:g} % for {GUARD.load_hold_for:g} s"
    ),
    "OVERCURRENT, I²t (share² above `heat.continuous`² × time): warning; HOLD; SETTLE": (
        f"{GUARD.tired_warn:g} s; {GUARD.tired_hold:g} s; {GUARD.tired_settle:g} s"
    ),
    "OVERTEMP: agreement": f"{GUARD.votes[0]} of {GUARD.votes[1]} readings",
    "OVERTEMP: single outlier, warning": f"{GUARD.spike:g} °C",
    "OVERTEMP: rise, warning": f"{GUARD.warming:g} °C/s over {GUARD.warming_over:g} s",
    "OVERTEMP: speed of motions of a hot joint": f"{GUARD.hot_pace * 100:g} %",
    "VOLTAGE: two readings agree": f"{ms(GUARD.volt_for)} apart",
    "OVERTEMP, VOLTAGE: not read, armed, warning": f"{GUARD.unread:g} s",
    "LOOKAHEAD_COLLISION: slowest speed before HOLD": f"{GUARD.least_pace * 100:g} %",
    "MIRROR_DRIFT": f"{GUARD.drift:g} rad for {GUARD.drift_for:g} s",
    "TORQUE_MISMATCH": f"{GUARD.disagreements} readings in a row",
    "SERVO_REBOOTED: clock error": f"{ms(GUARD.clock_slack)} + {GUARD.clock_drift * 100:g} % of the "
    "time between readings",
    "Interval of slow rules": ms(GUARD.look),
    # buses
    "BUS_ERRORS in 1 s: warning": f"{GUARD.errors_warn * 100:g} %",
    "BUS_ERRORS in 1 s: HOLD": f"{GUARD.errors_hold * 100:g} %, at least {GUARD.errors_least}",
    "BUS_ERRORS in a row: HOLD; fault": f"{GUARD.errors_row_hold}; {GUARD.errors_row_fault}",
    "FOREIGN_TRAFFIC in 1 s": f"{GUARD.foreign} packets",
    "TX_BACKLOG: fault": f"{GUARD.full} packets in a row",
    "CAN_BUS_STATE: all actuators silent": ms(GUARD.line_silent),
    "Servo watchdog": "100 ms",  # compared with the register below
    "Torque, hardware error, watchdog are read": f"at {serial_cycle_budget.STATUS_HZ:g} Hz or more",
    "Voltage, temperature are read": f"at {serial_cycle_budget.HEALTH_HZ:g} Hz or more",
    "Lost port: reopened": (
        f"after {bus_port.REOPEN_FIRST:g} s, then every {bus_port.REOPEN_MOST:g} s or sooner"
    ),
    "Missing devices: asked again": f"every {bus_port.IDENTIFY_AGAIN:g} s",
    # loop
    "LOOP_LATE: tick late, warning": ms(GUARD.late),
    "LOOP_LATE: ticks missed in a row, warning": f"{GUARD.missed_warn}",
    "LOOP_LATE: HOLD": f"{GUARD.missed_hold} ticks and {ms(GUARD.missed_for)}",
    "TIME_GAP": ms(GUARD.gap),
    "INTERNAL: failed ticks in a row, INHIBIT": f"{tick.PATIENCE}",
    "INHIBIT: no packets for": f"{tick.QUIET:g} s",
    "Repeated report of one joint": f"after {GUARD.quiet:g} s",
    "Repeated warning without change": f"after {GUARD.quiet_warning:g} s",
    # stops
    "Hold after a stop, `support: free`: SETTLE": f"after {GUARD.hold_most:g} s",
    "Way to the rest pose: planned duration": f"{torque_release.WAY:g} s",
    "Settling until torque off, else DAMP": f"{torque_release.SETTLE:g} s",
    "Way to the rest pose: given up": f"after {torque_release.WAYS} tries",
    "Longer way because of limits: given up": f"{torque_release.LATE:g} s after its planned end",
    "At rest, `support: free`": f"{torque_release.SLOW:g} rad/s for {torque_release.SLOW_FOR:g} s, "
    f"within {torque_release.NEAR:g} rad of the rest pose",
    "DAMP: at rest": f"{damping.SLOW:g} rad/s for {damping.SLOW_FOR:g} s, {damping.SLOW_MOST:g} s at most",
    "DAMP: goals follow at": f"{damping.SINK:g} rad/s",
    "DAMP: PWM or current; P gain": f"{soft.SHARE * 100:g} %; 1/{soft.SOFT}",
    # processes
    "Front process silent: restarted": f"after {front_process.HEARTBEAT:g} s",
    "Socket files: checked": f"every {ms(front_server.TEND)}",
    "`twindctl estop` without a socket: waits for the daemon's end": f"{estop.LOWERING:g} s",
    "Service manager: watchdog": unit("WatchdogSec"),
    "Service manager: wait for lowering": f"{unit('TimeoutStopSec')}; {cli.LOWERING:g} s "
    "after the signal arrived",
    "Service manager: wait for the fail-safe": f"{unit('TimeoutStartSec', 'twind-failsafe@.service')}; "
    f"{failsafe.LONGEST:g} s from its first tick ({failsafe.AGAIN:g} + {failsafe.WITHIN:g} + "
    f"{torque_release.LETTING_GO:g} s until torque is off + {failsafe.WAIT:g} s); "
    "longer where limits need it",
    "Fail-safe: wait for ports and devices": f"{failsafe.WAIT:g} s",
    "Fail-safe: speed, planned duration, DAMP after": f"{failsafe.SPEED * 100:g} % of every limit, "
    f"{failsafe.WAY:g} s, {failsafe.WITHIN:g} s",
    "Fail-safe: tries": f"{failsafe.TRIES}, begun within {failsafe.AGAIN:g} s",
}


def test_every_threshold_of_the_page_is_that_of_the_code() -> None:
    assert dict(table(REASON_CODES, "what", "value")) == THRESHOLDS


def test_the_servos_watchdog_is_what_the_page_says(armed: Rig) -> None:
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
