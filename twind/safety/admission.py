"""Admission by the gate: whether joints may move now, or torque may come on. Pure."""

import numpy as np

from twind.robot.arrays import Bools
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.modes import RESET_STATES, Mode, Motion, RobotState
from twind.robot.recovery_steps import codes_text, next_text, not_armed_text
from twind.safety.gate_types import GateSnapshot, GateThresholds
from twind.safety.headroom import headroom, is_unread


def admit(
    snapshot: GateSnapshot, commanded: Bools, thresholds: GateThresholds, *, setpoint: bool = False
) -> Verdict:
    """Check whether these joints may move now (LEASE_MISSING to THERMAL_HEADROOM).

    Hardware counts in live.

    A stream is checked at its first `setpoint`; a joint that gets hot later is slowed or settled by the
    guard.
    """
    refusals = [*_lease(snapshot), *_latches(snapshot), *_reach(snapshot), *snapshot.holding]
    warnings: list[Finding] = []
    if snapshot.mode is Mode.LIVE:
        if snapshot.state is not RobotState.ARMED:
            stopped = snapshot.state in RESET_STATES  # FAULT_LATCHED or ESTOP_LATCHED has the steps
            reason = f"state is {snapshot.state}" if stopped else not_armed_text(snapshot.state)
            refusals.append(Finding(ReasonCode.NOT_ARMED, message=reason))
        refusals += _limp(snapshot, commanded) + _calibration(snapshot, commanded)
        silent = _freshness(snapshot, commanded, thresholds)
        refusals += silent
        late, warnings = _latency(snapshot, thresholds)
        refusals += late
        if not (setpoint and snapshot.motion is Motion.STREAMING):
            refusals += _of_readings(_room(snapshot, commanded, thresholds), silent)
    return Verdict(tuple(refusals), tuple(warnings))


def arming(snapshot: GateSnapshot, thresholds: GateThresholds, joints: Bools | None = None) -> Verdict:
    """Check whether torque comes on (LEASE_MISSING to THERMAL_HEADROOM). In live only, from `connected`."""
    chosen = np.ones_like(snapshot.calibrated) if joints is None else joints
    refusals = [*_lease(snapshot), *_latches(snapshot), *_reach(snapshot)]
    if snapshot.mode is not Mode.LIVE:
        reason = f"mode {snapshot.mode} has no torque to switch on; arm in mode live"
        return Verdict((*refusals, Finding(ReasonCode.MODE_DENIES, message=reason)))
    if snapshot.state is not RobotState.CONNECTED:
        reason = f"state is {snapshot.state}; arming starts from connected"
        refusals.append(Finding(ReasonCode.ARM_FAILED, message=reason))
    if not chosen.any():
        refusals.append(Finding(ReasonCode.NO_JOINTS, message="no joint to arm"))
    # limp joints too: the others must not be driven into them, wherever they are
    everyone = np.ones_like(chosen)
    silent = _freshness(snapshot, everyone, thresholds)
    refusals += _calibration(snapshot, everyone) + silent
    late, warnings = _latency(snapshot, thresholds)
    room = _of_readings(_room(snapshot, chosen, thresholds), silent)
    return Verdict((*refusals, *late, *room, *snapshot.bars), tuple(warnings))


def _lease(snapshot: GateSnapshot) -> list[Finding]:
    """Check LEASE_MISSING."""
    reason = "this connection does not hold the lease; take it first"
    return [] if snapshot.lease_held else [Finding(ReasonCode.LEASE_MISSING, message=reason)]


def _latches(snapshot: GateSnapshot) -> list[Finding]:
    """Check FAULT_LATCHED and ESTOP_LATCHED.

    The states themselves count as latches, whatever the list says. The messages have the steps to a reset.
    """
    stops = {ReasonCode.ESTOP, ReasonCode.ESTOP_LATCHED}
    faults = tuple(dict.fromkeys(code for code in snapshot.latched if code not in stops))
    stopped = snapshot.state is RobotState.ESTOP or not stops.isdisjoint(snapshot.latched)
    failed = bool(faults) or snapshot.state in (RobotState.FAULT, RobotState.INHIBITED)
    if not (stopped or failed):
        return []
    codes = (*faults, ReasonCode.ESTOP) if stopped else faults
    live = snapshot.mode is Mode.LIVE
    steps = next_text(snapshot.state, codes, torque_on=snapshot.torque_on, live=live)
    findings = []
    if stopped:
        findings.append(Finding(ReasonCode.ESTOP_LATCHED, message=f"an e-stop is latched; {steps}"))
    if failed:
        named = codes_text(faults) or f"state is {snapshot.state}"
        findings.append(Finding(ReasonCode.FAULT_LATCHED, message=f"{named}; {steps}"))
    return findings


def _reach(snapshot: GateSnapshot) -> list[Finding]:
    """Check SOCKETS_GONE: no motion begins while no client can connect, as an e-stop could not be sent."""
    return [] if snapshot.unreachable is None else [snapshot.unreachable]


def _limp(snapshot: GateSnapshot, chosen: Bools) -> list[Finding]:
    """Check JOINT_LIMP."""
    if snapshot.limp is None:
        return []
    reason = "stays limp by request and follows no command: disarm, then arm it too"
    limp = np.flatnonzero(chosen & snapshot.limp)
    return [Finding(ReasonCode.JOINT_LIMP, joint=int(joint), message=reason) for joint in limp]


def _calibration(snapshot: GateSnapshot, chosen: Bools) -> list[Finding]:
    """Check CALIB_MISMATCH."""
    reason = "no measured zero; calibrate this joint"
    missing = [
        Finding(ReasonCode.CALIB_MISSING, joint=int(joint), message=reason)
        for joint in np.flatnonzero(chosen & ~snapshot.calibrated)
    ]
    return missing + list(snapshot.mismatches)


def _freshness(snapshot: GateSnapshot, chosen: Bools, thresholds: GateThresholds) -> list[Finding]:
    """Check HW_DISCONNECTED. An age that is negative or NaN is too old."""
    fresh = (snapshot.age >= 0.0) & (snapshot.age <= thresholds.stale)
    reason = "no fresh reading (s); check its cable and power"
    return [
        Finding(
            ReasonCode.HW_DISCONNECTED,
            int(joint),
            None,
            None,
            float(snapshot.age[joint]),
            thresholds.stale,
            reason,
        )
        for joint in np.flatnonzero(chosen & ~fresh)
    ]


def _latency(snapshot: GateSnapshot, thresholds: GateThresholds) -> tuple[list[Finding], list[Finding]]:
    """Check LATENCY_BLOCK; return refusals and warnings. Unknown or negative refuses."""
    block = thresholds.latency_block
    warn = thresholds.latency_warn
    refusals = []
    warnings = []
    for value, what in ((snapshot.latency, "now"), (snapshot.latency_p95, "95 % of the last 0.5 s")):
        reason = f"state age + bus round trip, {what} (s)"
        if not 0.0 <= value <= block:
            refusals.append(Finding(ReasonCode.LATENCY_BLOCK, value=value, bound=block, message=reason))
        elif not value <= warn:
            warnings.append(Finding(ReasonCode.LATENCY_WARN, value=value, bound=warn, message=reason))
    return refusals, warnings


def _of_readings(room: list[Finding], silent: list[Finding]) -> list[Finding]:
    """Return the findings without those that only say that a silent joint was not read (HW_DISCONNECTED)."""
    joints = {finding.joint for finding in silent}
    return [each for each in room if each.joint not in joints or not is_unread(each)]


def _room(snapshot: GateSnapshot, chosen: Bools, thresholds: GateThresholds) -> list[Finding]:
    """Check THERMAL_HEADROOM."""
    if snapshot.condition is None:
        reason = "temperature and supply are unknown"
        return [
            Finding(code, message=reason) for code in (ReasonCode.THERMAL_HEADROOM, ReasonCode.VOLTAGE_LOW)
        ]
    return headroom(snapshot.condition, chosen, thresholds.health)
