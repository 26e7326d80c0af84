"""Request of an end-stop search, in counts; or the reasons against it. Loop's process.

Nothing here writes. The bounds are few and hard: a client may request less, never more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, floor, isfinite, tau

import numpy as np

from twind import link
from twind.config.robot_spec import JointSpec
from twind.loop.bus.bus_port import BusPort
from twind.loop.procedures.gate_input import GateInput
from twind.loop.procedures.joint_verification import JointVerificationState
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import ProcedureFailed
from twind.loop.procedures.torque_readback import torque_off
from twind.motion.endstop_search import MARGIN, USUAL_SHARE, USUAL_SPEED, USUAL_TIMES, HomingParameters
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_map import JointBusMap
from twind.safety import admission
from twind.safety.multiturn import STATED_NEAR

# Ranges of the request.
SHARES = (0.03, 0.15)  # of the current limit
SPEEDS = (0.02, 0.5)  # rad/s of the joint
TIMES = (2, 10)
# rad that the joint backs off, and rad inside its limits, so that it can be armed there
BACK = 0.1
INSIDE = 0.02
LEAD = 0.2  # rad that a goal may be ahead of the joint
ASTRAY = 0.15  # rad that the joint may go against the search direction; more means a wrong sign or load
STILL = 0.006  # rad that a standing joint may flicker, two counts at least
SLACK = 8  # counts that the joint may hang further away than when the search was requested
SLOWEST = 0.025  # s, the longest period of a loop that reads often enough to stop the joint in time
# divisor of a turn: difference from a whole turn that a mode change may cause; more is a wrong offset
OFF_TURN = 16
HASTE = 2.0  # factor on the goals' speed for the servo's own profile


@dataclass(frozen=True, slots=True)
class HomingRequest:
    """End-stop search of one joint. Counts are calibrated: raw plus whole turns."""

    joint: int
    port: BusPort
    id: int
    search: HomingParameters
    lower: int  # counts: the goals that may ever be sent (WIRE_CLAMP)
    upper: int
    turn: int  # counts
    jump: float  # counts that it may move when torque comes on
    profile: int  # raw velocity
    cap: int  # raw current
    shift: int  # counts: calibrated minus raw; of the turn furthest from the stop where it is unknown


def resolve_request(
    context: ProcedureContext,
    gate_input: GateInput,
    verified: JointVerificationState,
    command: link.FindStop,
    now: float,
) -> HomingRequest | list[Finding]:
    """Return the request in counts, or all findings against it."""
    against = [*_check_request(command), *_allowed(context, gate_input, verified, command, now)]
    unknown = verified.ambiguous_turn(command.joint) is not None
    return against if against else _counted(context, command, unknown)


def _check_request(command: link.FindStop) -> list[Finding]:
    """Return findings for numbers that are out of bounds; NaN is."""
    given = (
        ("current_share of the current limit", command.current_share, SHARES),
        ("speed, rad/s", command.speed, SPEEDS),
        ("times", command.times, TIMES),
    )
    found = []
    for what, value, (least, most) in given:
        if value is not None and not least <= value <= most:
            bound = most if value > most else least
            found.append(Finding(ReasonCode.BAD_SCHEMA, value=float(value), bound=float(bound), message=what))
    return found


def _allowed(
    context: ProcedureContext,
    gate_input: GateInput,
    verified: JointVerificationState,
    command: link.FindStop,
    now: float,
) -> list[Finding]:
    """Return what would refuse arming of this joint, and the further requirements of a stop search."""
    joint = command.joint
    mine = np.arange(len(context.robot.joints)) == joint
    verdict = admission.arming(gate_input.snapshot(command.client, now), gate_input.thresholds, mine)
    found = [each for each in verdict.refusals if each.code is not ReasonCode.ARM_FAILED]
    doubt = verified.ambiguous_turn(joint)
    found = [each for each in found if each.joint in (None, joint) and each != doubt]
    spec = context.robot.bound.file.joints[joint]
    robot = context.robot.bound.file

    def against(message: str, code: ReasonCode = ReasonCode.STOP_NOT_FOUND) -> None:
        found.append(Finding(code, joint, message=message))

    if not context.hardware.connected:
        found.append(Finding(ReasonCode.HW_DISCONNECTED, message="not every bus is open and identified"))
    verified_or_turn_unknown = verified.joints[joint] or doubt is not None
    if context.robot.joints.calibrated[joint] and not verified_or_turn_unknown and not found:
        against("not verified since its bus was identified: `twindctl status`", ReasonCode.CALIB_MISMATCH)
    if torque_off(context) is not True:
        against("torque is on somewhere, or not known yet: disarm first", ReasonCode.TORQUE_MISMATCH)
    if spec.stops.endstop_of_side(command.side) is None:
        against(f"the robot file has no stop_rad.{command.side} of it: the position of that stop is unknown")
    if not spec.type.finds_endstops:
        against(f"a {spec.type.device} is not driven against a stop: move it there by hand, and sweep it")
    if spec.transmission:
        against(f"transmission {spec.transmission} turns it: its stop is not that of one actuator")
    if robot.support not in ("fixed", "gantry") and spec.name in robot.legs:
        against("it carries a robot that stands freely: hang the robot up and set support: gantry")
    if context.robot.period > SLOWEST:
        against(
            f"the loop runs at {1.0 / context.robot.period:g} Hz, and a search needs {1.0 / SLOWEST:g} Hz"
        )
    if not isfinite(spec.type.full_effort):
        against("its type has no current_limit_a, or reports no current: there is nothing to cap")
    return found


def _counted(
    context: ProcedureContext, command: link.FindStop, unknown: bool
) -> HomingRequest | list[Finding]:
    """Return the search in counts. `unknown`: several turns fit where the joint stands."""
    joint = command.joint
    spec = context.robot.bound.file.joints[command.joint]
    number, row, bus = place_on_bus(context, joint)
    port = context.hardware.ports[number]
    scale = float(bus.scale[row])
    raw = int(context.hardware.readings.raw.ticks[joint])
    shift = int(context.hardware.readings.shift[joint])
    device = next((each for each in port.devices if each.id == bus.ids[row]), None)
    own = None if device is None else spec.type.own_current_limit(device)
    share = USUAL_SHARE if command.current_share is None else command.current_share
    search = _search(command, spec, int(bus.zero[row]), scale, _cap(share, spec, own))
    nearer = 0
    if unknown:
        search, shift, nearer = _over_turns(search, raw, joint, context)
        turns = context.robot.joints.turns
        assert turns is not None
        span = float(turns.last[joint] - turns.first[joint])
        if search.away + search.margin > span:
            message = (
                "counts away from its stop that prove its turn, more than its travel leaves: state a pose, "
                "`twindctl calibrate turn --pose`"
            )
            bound = span - search.margin
            return [
                Finding(ReasonCode.STOP_NOT_FOUND, joint, value=search.away, bound=bound, message=message)
            ]
    count = raw + shift
    end = search.expected + search.way * search.margin
    if (end - count) * search.way <= 0.0:
        beyond = (count - search.expected) * search.way
        message = "counts beyond where the stop should be already: wrong stop_rad, side or coarse zero?"
        return [Finding(ReasonCode.STOP_NOT_FOUND, joint, value=beyond, bound=search.margin, message=message)]
    back = max(search.back, search.away)
    away = search.expected - search.way * (nearer + search.margin + back + search.still)
    ends = (end, away, count - search.way * SLACK)
    rate = HASTE * search.speed * tau / spec.type.ticks_per_turn  # rad/s of the servo
    return HomingRequest(
        joint=joint,
        port=port,
        id=bus.ids[row],
        search=search,
        lower=floor(min(ends)) - 1,
        upper=ceil(max(ends)) + 1,
        turn=spec.type.ticks_per_turn,
        jump=0.05 / abs(scale),
        profile=max(1, ceil(rate / spec.type.velocity_lsb_rad_s)),
        cap=int(search.cap),
        shift=shift,
    )


def _over_turns(
    search: HomingParameters, raw: int, joint: int, context: ProcedureContext
) -> tuple[HomingParameters, int, int]:
    """Return the search of a joint whose turn is unknown.

    Besides, the shift (counts) of the turn furthest from the stop, and the counts by which the stop may lie
    nearer. At the end the joint moves so far away from its stop that no place a turn from there leaves room.
    """
    turns = context.robot.joints.turns
    assert turns is not None
    whole = int(turns.whole[joint])
    first = int(turns.first[joint])
    last = int(turns.last[joint])
    room = int(turns.room[joint])
    least = -((raw - (first - room)) // whole)
    most = (last + room - raw) // whole
    shift = (least if search.way > 0 else most) * whole
    margin = min(search.margin, whole / STATED_NEAR)
    away = max(0.0, last - first - whole + room + margin + search.back)
    return replace(search, turn=float(whole), margin=margin, away=away), shift, (most - least) * whole


def _search(command: link.FindStop, spec: JointSpec, zero: int, scale: float, cap: float) -> HomingParameters:
    stop = spec.stops.endstop_of_side(command.side)
    assert stop is not None
    up = 1 if scale > 0.0 else -1
    speed = min(USUAL_SPEED if command.speed is None else command.speed, spec.velocity_limit)

    def counts(angle: float) -> float:
        return angle / abs(scale)

    return HomingParameters(
        way=up if command.side == "upper" else -up,
        expected=zero + stop / scale,
        margin=counts(MARGIN),
        speed=counts(speed),
        cap=cap,
        back=counts(max(BACK, abs(stop - (spec.lower if command.side == "lower" else spec.upper)) + INSIDE)),
        lead=counts(LEAD),
        astray=counts(ASTRAY),
        still=max(2.0, counts(STILL)),
        times=USUAL_TIMES if command.times is None else command.times,
    )


def _cap(share: float, spec: JointSpec, own: int | None) -> float:
    """Return that share of the limit, raw: of the robot file, or of the servo itself where that is less."""
    full = spec.type.full_effort if own is None else min(spec.type.full_effort, own)
    return max(1.0, floor(share * full))


def place_on_bus(context: ProcedureContext, joint: int) -> tuple[int, int, JointBusMap]:
    """Return the joint's bus and its place there.

    Counts are calibrated: the maps are those of the file, not of the wire.
    """
    for number, bus in enumerate(context.robot.joints.buses):
        rows = np.flatnonzero(bus.joints == joint)
        if rows.size:
            return number, int(rows[0]), bus
    raise KeyError(joint)


def turns_between(before: int, raw: int, turn: int) -> int:
    """Return the whole turns (counts) between the calibrated count before and the raw one in the other mode.

    Raises ProcedureFailed.
    """
    shift = turn * round((before - raw) / turn)
    off = abs(before - raw - shift)
    if off > turn / OFF_TURN:
        message = "counts that are no whole turn, when its mode changed: a homing offset beyond 1024?"
        raise ProcedureFailed.measured(ReasonCode.CALIB_MISMATCH, off, turn / OFF_TURN, message)
    return shift
