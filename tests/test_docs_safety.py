"""docs/safety.md says what the code does: reason codes, states, numbers, proofs."""

import re

from pages import ROOT, SAFETY, table
from rig import Rig

from twind import cli
from twind.config import settings
from twind.ctl import estop
from twind.front import server
from twind.loop import arming, damping, failsafe, front_process, ports, release, submissions, tick
from twind.robot.finding import Code
from twind.robot.modes import State
from twind.safety import alarm, gate, guard, health, lease, senses, stream, way
from twind.safety.states import TABLE, Event
from twind.twin import binding, reach
from twind_drivers.dynamixel import budget
from twind_drivers.dynamixel import damping as soft

# ----------------------------------------------------------------------------------------------- reason codes

NONE = "–"
CODES = table(SAFETY, "code", "rule", "when", "what to do")


def rules() -> dict[str, str]:
    """Code -> its rule, as the comment beside it says."""
    source = (ROOT / "twind" / "robot" / "finding.py").read_text()
    found = re.findall(r'^    ([A-Z_]+) = "\1"(?:  # ([SR]\d\d))?', source, re.MULTILINE)
    return {code: rule or NONE for code, rule in found}


def test_every_code_has_one_row_with_its_rule_a_cause_and_a_remedy() -> None:
    assert {code.strip("`"): rule for code, rule, _, _ in CODES} == rules()
    assert sorted(code for code, *_ in CODES) == sorted(f"`{code}`" for code in Code)
    assert all(len(when) > 10 and len(remedy) > 5 for _, _, when, remedy in CODES)


def test_a_code_that_nothing_raises_is_said_to_be_so_and_no_other() -> None:
    sources = "".join(
        path.read_text() for path in (ROOT / "twind").rglob("*.py") if path.name != "finding.py"
    )
    unused = {code.value for code in Code if not re.search(rf"Code\.{code.name}\b", sources)}
    assert {code.strip("`") for code, _, when, _ in CODES if "not raised yet" in when} == unused


# ----------------------------------------------------------------------------------------------- states


def steps(cell: str) -> set[tuple[str, str]]:
    """`a`, `b` → `c`; `d` → `e`. `any` is every state but those named after it, and but the end itself."""
    found = set()
    for one in cell.split(";"):
        before, _, after = one.partition("→")
        end, named = after.strip().strip("`"), set(re.findall(r"`(\w+)`", before))
        starts = (
            {state.value for state in State} - named - {end} if before.strip().startswith("any") else named
        )
        found |= {(start, end) for start in starts}
    return found


def test_the_table_of_states_is_that_of_the_code() -> None:
    rows = {event: steps(cell) for event, _, cell in table(SAFETY, "event", "who", "from → to")}
    assert set(rows) == {event.value for event in Event}
    for event, follows in TABLE.items():
        moves = {(start.value, end.value) for start, end in follows.items() if start is not end}
        assert rows[event.value] == moves, event


# ----------------------------------------------------------------------------------------------- numbers

GATE, GUARD = gate.Thresholds(), guard.Thresholds()


def ms(seconds: float) -> str:
    return f"{seconds * 1e3:g} ms"


def unit(key: str, name: str = "twind.service") -> str:
    """A number of a unit."""
    found = re.search(rf"^{key}=(\d+)$", (ROOT / "systemd" / name).read_text(), re.MULTILINE)
    assert found
    return f"{found[1]} s"


NUMBERS = {
    "latency (state age + bus round trip): told": ms(GATE.latency_warn),
    "a hop of a reading or of a setpoint: told": f"{health.LATENCY * 1e3:g} ms",
    "hop `moved`: a joint that stood is asked for, and shows, a move of": f"{way.VISIBLE:g} rad",
    "what was told of a hop: over, and may be told again": (
        f"below {alarm.CALM * 100:g} % of its bound for more than {alarm.CALM_FOR:g} s"
    ),
    "latency: motion and arming refused": ms(GATE.latency_block),
    "joint not heard: motion and arming refused": ms(GATE.stale),
    "temperature and supply, oldest: motion and arming refused": f"{GATE.health:g} s",
    "joint silent, armed: told": f"{ms(GUARD.stale_warn)}; 1.5 ticks below 50 Hz",
    "joint silent, armed: HOLD": ms(GUARD.stale_hold),
    "joint silent, armed: fault": ms(GUARD.stale_fault),
    f"joint off its goal, and {ms(GUARD.lag)} of the goal's speed: HOLD where it is, fault": (
        f"{GUARD.follow:g} rad for {ms(GUARD.follow_for)}"
    ),
    "the same: DAMP, fault": f"{GUARD.follow_damp:g} rad",
    "position that never changes while the motor works: HOLD, fault": f"{ms(GUARD.frozen_for)}, the goal "
    f"{GUARD.frozen_moved:g} rad further and {GUARD.frozen_turning:g} rad/s told; or the goal "
    f"{GUARD.frozen_far:g} rad further at {GUARD.frozen_load[0] * 100:g} to "
    f"{GUARD.frozen_load[1] * 100:g} % load",
    "joint too fast: HOLD": f"{GUARD.overspeed:g} × its limit + {GUARD.overspeed_slack:g} rad/s, "
    f"{GUARD.overspeed_row} readings",
    "robot and simulation apart: told": f"{GUARD.drift:g} rad for {GUARD.drift_for:g} s",
    "load near the current limit: told": f"{GUARD.load_warn * 100:g} % for {GUARD.load_warn_for:g} s",
    "load at the current limit: HOLD where it is, fault; after twice that DAMP": (
        f"{GUARD.load_hold * 100:g} % for {GUARD.load_hold_for:g} s"
    ),
    "tired, share² beyond `heat.continuous`² × time: told, HOLD, SETTLE": f"{GUARD.tired_warn:g} s, "
    f"{GUARD.tired_hold:g} s, {GUARD.tired_settle:g} s",
    "temperature as agreed on": f"by {GUARD.votes[0]} of {GUARD.votes[1]} readings",
    "temperature of one reading above the others: told, not believed": f"{GUARD.spike:g} °C",
    "temperature rising: told": f"{GUARD.warming:g} °C/s over {GUARD.warming_over:g} s",
    "a hot joint: pace of motions": f"{GUARD.hot_pace * 100:g} %",
    "supply low: as two readings agree": f"{ms(GUARD.volt_for)} apart",
    "temperature and supply not read, armed: told": f"{GUARD.unread:g} s",
    "way ahead too close: slowest pace before HOLD": f"{GUARD.least_pace * 100:g} %",
    "no tick, or asleep, armed: fault": ms(GUARD.gap),
    "held after a stop of ours, `support: free`: SETTLE": f"{GUARD.hold_most:g} s",
    "what takes long is looked at": f"every {ms(GUARD.look)}",
    "bad exchanges of a bus in 1 s: told": f"{GUARD.errors_warn * 100:g} %",
    "bad exchanges of a bus in 1 s: HOLD": f"{GUARD.errors_hold * 100:g} %, at least {GUARD.errors_least}",
    "bad exchanges of a bus in a row: HOLD": f"{GUARD.errors_row_hold}",
    "bad exchanges of a bus in a row: fault": f"{GUARD.errors_row_fault}",
    "packets that nobody asked for, in 1 s: fault, INHIBIT": f"{GUARD.foreign}",
    "packets in a row without room in the port: fault": f"{GUARD.full}",
    "nobody on a CAN bus answers, armed or arming: fault": ms(GUARD.line_silent),
    "a servo's own clock, off between two readings: fault": f"{ms(GUARD.clock_slack)} + "
    f"{GUARD.clock_drift * 100:g} % of the time between",
    "a position that cannot be": f"{senses.REACH:g} × the motor's fastest × the time between + "
    f"{senses.TICKS:g} ticks",
    "such positions in a row: HOLD": f"{GUARD.jumps}",
    "tick late: told": ms(GUARD.late),
    "ticks missed in a row: told": f"{GUARD.missed_warn}",
    "ticks missed in a row: HOLD": f"{GUARD.missed_hold}, and {ms(GUARD.missed_for)}",
    "torque read back off in a row: fault": f"{GUARD.disagreements} readings",
    "ticks failed in a row: inhibit, end": f"{tick.PATIENCE}",
    "after an inhibit: no packet": f"{tick.QUIET:g} s",
    "the same is told again of the same joint": f"{GUARD.quiet:g} s",
    "the same warning, that changes nothing, is told again": f"{GUARD.quiet_warning:g} s",
    "trajectory, longest": f"{GATE.max_duration:g} s, {GATE.max_points} points",
    "trajectory points, least distance": ms(GATE.min_dt),
    "trajectory judged beside the tick": f"{submissions.SLICE} points a tick",
    "front's share of a verdict, oldest": f"{submissions.STALE_VERDICT:g} s",
    "hard limit beyond the robot file's": f"{reach.BEYOND:g} rad",
    "measured beyond the hard limit: fault": f"{GUARD.beyond_hard:g} rad",
    "start jump": f"{GATE.start_jump:g} rad",
    "brake: always allowed": f"{GATE.brake_floor:g} rad/s",
    "brake: kept back": f"{GATE.brake_margin:g} rad/s",
    "end counts as rest": f"{GATE.end_velocity:g} rad/s",
    "jerk: told": f"{GATE.jerk_warn:g} rad/s³",
    "trajectories of one process; marks": f"{server.Front.CALLS_PER_SECOND} a second",
    "lease": f"{lease.TRAJECTORY:g} s",
    "lease while streaming": f"{lease.STREAMING:g} s",
    "newest setpoint, oldest": f"{GUARD.setpoint_age:g} s",
    "setpoint `valid_for`, longest": f"{stream.LONGEST:g} s",
    "arming: reading, oldest": ms(arming.FRESH),
    "arming: first reading of temperature and supply waited for": f"{arming.FIRST:g} s",
    "arming: still moving": f"{arming.STILL:g} ticks of the encoder, {arming.TRIES} tries",
    "arming: jump at torque-on": f"{arming.JUMP:g} rad",
    "turn: beyond the measured travel, at most": f"{binding.ASTRAY:g} rad",
    "way to the rest pose, wanted within": f"{release.WAY:g} s",
    "settling, to torque off; then DAMP": f"{release.SETTLE:g} s",
    "way to the rest pose, given up": f"after {release.WAYS} tries",
    "way that the limits make longer, given up": f"{release.LATE:g} s after its planned end",
    "`support: free`: at rest": f"{release.SLOW:g} rad/s for {release.SLOW_FOR:g} s, "
    f"within {release.NEAR:g} rad of the rest pose",
    "damped: at rest": f"{damping.SLOW:g} rad/s for {damping.SLOW_FOR:g} s, {damping.SLOW_MOST:g} s at most",
    "damped: goals follow at": f"{damping.SINK:g} rad/s",
    "damped: output, or current": f"{soft.SHARE * 100:g} %",
    "damped: P gain": f"1/{soft.SOFT}",
    "servo watchdog": "100 ms",  # compared with the register below
    "torque, hardware error, watchdog read": f"{budget.STATUS_HZ:g} Hz or more",
    "voltage, temperature read": f"{budget.HEALTH_HZ:g} Hz or more",
    "lost port reopened": f"after {ports.REOPEN_FIRST:g} s, then up to every {ports.REOPEN_MOST:g} s",
    "missing devices asked again": f"every {ports.IDENTIFY_AGAIN:g} s",
    "front silent: killed, started anew": f"{front_process.HEARTBEAT:g} s",
    "files of the listening sockets are checked": f"every {ms(server.TEND)}",
    "`twindctl estop` without a socket: the daemon's end is awaited": f"{estop.LOWERING:g} s",
    "service manager's watchdog": unit("WatchdogSec"),
    "fail-safe: ports, devices and their torque waited for": f"{failsafe.WAIT:g} s",
    "fail-safe: lowered at, wanted within, damped after": f"{failsafe.SPEED * 100:g} % of every limit, "
    f"{failsafe.WAY:g} s, {failsafe.WITHIN:g} s",
    "fail-safe: tried": f"{failsafe.TRIES} times, begun within {failsafe.AGAIN:g} s",
    "service manager waits for the fail-safe": f"{unit('TimeoutStartSec', 'twind-failsafe@.service')}; "
    f"from its first tick {failsafe.LONGEST:g} s ({failsafe.AGAIN:g} + {failsafe.WITHIN:g} + "
    f"{release.LETTING_GO:g} s to torque off + {failsafe.WAIT:g} s), "
    "and more where the limits make the way longer",
    "service manager waits for the lowering": f"{unit('TimeoutStopSec')}, {cli.LOWERING:g} s once the daemon "
    "has heard that it shall end",
}


def test_every_number_is_that_of_the_code() -> None:
    assert dict(table(SAFETY, "what", "value")) == NUMBERS


def test_the_servos_watchdog_is_what_the_page_says(armed: Rig) -> None:
    assert set(armed.register("bus_watchdog").tolist()) == {5}  # x 20 ms


def test_the_formulas_of_the_page_are_those_of_the_gate() -> None:
    text = " ".join(SAFETY.split())
    assert f"max({GATE.brake_floor:g}, √(2·a·d) − {GATE.brake_margin:g}) rad/s" in text
    assert f"{GATE.start_jump:g} rad plus velocity limit × time of the first point" in text
    warn, block = settings.LATENCY_WARN_MS, settings.LATENCY_BLOCK_MS
    assert (warn, block) == (GATE.latency_warn * 1e3, GATE.latency_block * 1e3)


def test_the_tests_that_prove_it_exist() -> None:
    named = [path for _, cell in table(SAFETY, "claim", "tests") for path in re.findall(r"`([^`]+)`", cell)]
    assert len(named) > 12 and not [path for path in named if not (ROOT / path).is_file()]
