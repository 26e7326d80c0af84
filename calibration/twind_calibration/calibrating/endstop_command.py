"""`twindctl calibrate endstop`: announce the motion, ask, find the endstop, write. Blocks."""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, isnan
from statistics import fmean, pstdev

from twind.client import Client
from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, Rejected, UsageError, calibrating, operator
from twind.config.calibration_file import Calibration, JointCalibration
from twind.config.counts import angle_of
from twind.motion.endstop_search import MARGIN, USUAL_SHARE, USUAL_SPEED, USUAL_TIMES
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator, slots
from twind_calibration.calibrating.calibration_context import CalibrationContext, ground
from twind_calibration.calibrating.entry_writer import (
    agreed,
    next_steps,
    require_terminal,
    write_entries,
)
from twind_calibration.calibrating.recorded_devices import differences, records
from twind_calibration.calibrating.zero_placement import ZeroOffset, make_entry, misfits
from twind_calibration.rejection_hints import with_hints


@dataclass(frozen=True, slots=True)
class EndstopPlan:
    """Planned search of one endstop, by robot file and options."""

    slot: CalibrationActuator
    side: str
    stop: float  # rad, as described
    share: float | None  # of the current limit; None: the daemon's own
    speed: float | None  # rad/s; None: the daemon's own
    times: int | None
    proves_turn: bool = False  # its turn is unknown: it then moves across its travel

    def describe(self, at: float | None) -> str:
        """Describe the motion: joint, target and strength. `at`: present angle (rad)."""
        kind = self.slot.joint.type
        share = USUAL_SHARE if self.share is None else self.share
        most = share * kind.full_current_a
        pull = share * kind.effort_limit_nm
        strength = f"{share:.0%} of its current limit" + (f", {most:.2f} A" if isfinite(most) else "")
        strength += f", about {pull:.2f} N·m" if isfinite(pull) else ""
        way = "" if at is None else f", {abs(self.stop - at):.2f} rad from where it is"
        speed = USUAL_SPEED if self.speed is None else self.speed
        strength += ", then back across its travel to prove its turn" if self.proves_turn else ""
        return (
            f"{self.slot.name} will move by itself: to its {self.side} stop at {self.stop:+.3f} rad{way}, "
            f"no further than {MARGIN:g} rad beyond, at {speed:g} rad/s, with at most {strength}, "
            f"{self.times or USUAL_TIMES} times. All others are limp: the robot must hang or lie"
        )


@with_hints
def endstop(options: argparse.Namespace) -> int:
    """Exit code 0: done. Raises Rejected, UsageError, ClientError."""
    with operator(options) as client:
        return _endstop(options, client)


def _endstop(options: argparse.Namespace, client: Client) -> int:
    place = ground(options, client)
    touch = plan_endstop(options, place, options.joint)
    require_terminal(options)
    calibration = place.calibration()
    entry = None if calibration is None else calibration.by_name.get(touch.slot.name)
    if calibration is None or entry is None:
        first = "`twindctl calibrate sweep`, then `zero --from-sweep`"
        raise Rejected(f"{touch.slot.name} is not calibrated, not even coarsely: {first}, first")
    counts = drive_to_stop(options, client, place, touch, entry)
    fresh = make_endstop_entry(touch, entry, counts)
    _show(options, touch, entry, fresh, counts)
    return _write(options, place, calibration, fresh)


def drive_to_stop(
    options: argparse.Namespace,
    client: Client,
    place: CalibrationContext,
    touch: EndstopPlan,
    entry: JointCalibration,
) -> list[int]:
    """Announce the motion, ask, drive; return the captures. Raises Rejected: nothing moved, or no stop."""
    _require_ready(client, place, touch, entry)
    if not options.json:
        print(touch.describe(_position(client, touch.slot.joint.name)), flush=True)
    if not agreed(options, "are all persons clear of it: go?"):
        raise Rejected("nothing moved")
    with calibrating(client, take=options.take):
        return _capture_stops(options, client, touch)


def plan_endstop(options: argparse.Namespace, place: CalibrationContext, joint_name: str) -> EndstopPlan:
    """Return the plan. Raises Rejected: no such joint or stop; UsageError: the side is not given."""
    every = {slot.name: slot for slot in slots(place.robot)}
    [name] = place.select_actuators([joint_name], list(every))
    slot = every[name]
    joint = every[name].joint
    ends = joint.stops.endstops_by_side
    if not ends:
        raise Rejected(f"{name}: {place.robot.path} describes no stop of it (`stop_rad`)")
    asked = options.side or (joint.homing.side if joint.homing is not None else None)
    if asked is None and len(ends) > 1:
        raise UsageError(f"{name} has two stops: add --side lower or --side upper")
    side = asked or next(iter(ends))
    if side not in ends:
        raise Rejected(f"{name}: {place.robot.path} describes no {side} stop of it (`stop_rad`)")
    if not joint.type.finds_endstops:
        raise Rejected(f"{name} is a {joint.type.device}: it cannot be driven against a stop")
    homing = joint.homing
    current = options.current if options.current is not None or homing is None else homing.current_a
    speed = options.speed if options.speed is not None or homing is None else homing.speed
    if current is not None and isnan(joint.type.full_current_a):
        raise Rejected(
            f"type {joint.type.name} has no current_limit_a: the share of {current:g} A is unknown"
        )
    share = None if current is None else current / joint.type.full_current_a
    return EndstopPlan(slot, side, ends[side], share, speed, options.times)


def _require_ready(
    client: Client, place: CalibrationContext, touch: EndstopPlan, entry: JointCalibration
) -> None:
    """Raises Rejected: another mode, a servo that is not as it was calibrated."""
    mode = client.call("GetStatus")["status"]["mode"]
    if mode != "live":
        raise Rejected(f"mode {mode} moves no robot: `twindctl mode live`, then again")
    known = {touch.slot.name: entry.device}
    found = records(client, place.robot, [touch.slot], known).get(touch.slot.name)
    changed = ["no device answers there"] if found is None else differences(entry.device, found)
    if changed:
        raise Rejected(
            f"{touch.slot.name} is not as it was calibrated: {', '.join(changed)}: put that right first, or "
            "calibrate it anew"
        )


def _position(client: Client, name: str) -> float | None:
    for each in client.call("GetStatus", joints=True)["joints"]:
        if each["name"] == name:
            position: float | None = each["position"]
            return position
    return None


def _capture_stops(options: argparse.Namespace, client: Client, touch: EndstopPlan) -> list[int]:
    """The captures. Raises Rejected: none, and why; ClientError."""
    how = {"current_share": touch.share, "speed": touch.speed, "times": touch.times}
    given = {key: value for key, value in how.items() if value is not None}
    last = {}
    phase = ""
    told = -inf
    with ProgressLine(options, touch.slot.name) as progress:
        for last in client.stream("FindStop", joint=touch.slot.joint.name, side=touch.side, **given):
            if options.json:
                news = {"joint": touch.slot.name, "phase": last["phase"], "progress": last["progress"]}
                print(json.dumps(news), flush=True)
            elif progress.live:
                progress.update(last["phase"], last["progress"])
            elif last["phase"] != phase or last["progress"] - told >= 0.1:
                phase = last["phase"]
                told = last["progress"]
                print(f"{touch.slot.name}: {phase}, {told:.0%}", file=sys.stderr, flush=True)
    if not last.get("ticks"):
        why = "; ".join(finding["message"] for finding in last.get("findings") or ()) or "it was cut short"
        raise Rejected(f"{touch.slot.name}: {why}. Nothing was written")
    return [int(count) for count in last["ticks"]]


def make_endstop_entry(
    touch: EndstopPlan, entry: JointCalibration, counts: Sequence[int]
) -> JointCalibration:
    """The entry with the zero that follows, and the travel's end where the stop was met.

    `counts` may be whole turns off the file's. Raises Rejected: it does not fit the travel.
    """
    slot = touch.slot
    turn = touch.slot.joint.type.ticks_per_turn
    mean = fmean(counts)
    expected = entry.zero_ticks + touch.stop / slot.rad_per_tick
    mean += turn * round((expected - mean) / turn)
    zero = ZeroOffset(round(mean - touch.stop / slot.rad_per_tick), pstdev(counts), len(counts), "endstop")
    low, high = entry.sweep_ticks
    downwards = (touch.side == "lower") == (slot.rad_per_tick > 0.0)
    sweep = (round(mean), high) if downwards else (low, round(mean))
    wrong = misfits(slot, entry.device, sweep, zero.ticks) if sweep[0] < sweep[1] else ["no travel is left"]
    if wrong:
        raise Rejected(
            f"{slot.name}: met its stop at {mean:.0f}, and {'; '.join(wrong)}. Nothing was written"
        )
    return make_entry(slot, entry.device, sweep, zero)


def _show(
    options: argparse.Namespace,
    touch: EndstopPlan,
    before: JointCalibration,
    fresh: JointCalibration,
    counts: Sequence[int],
) -> None:
    moved = angle_of(touch.slot.joint, before.zero_ticks, fresh.zero_ticks)
    if options.json:
        told: Mapping[str, object] = {
            "joint": touch.slot.name,
            "side": touch.side,
            "ticks": list(counts),
            "zero_ticks": fresh.zero_ticks,
            "sigma_ticks": round(fresh.zero_sigma_ticks, 3),
            "moved_rad": round(moved, 6),
            "sweep_ticks": list(fresh.sweep_ticks),
        }
        print(json.dumps(told), flush=True)
        return
    print(
        f"{touch.slot.name}: its {touch.side} stop is at {', '.join(map(str, counts))}; zero "
        f"{before.zero_ticks} -> {fresh.zero_ticks} ({moved:+.4f} rad), travel {fresh.sweep_ticks[0]}.."
        f"{fresh.sweep_ticks[1]}; torque is off",
        flush=True,
    )


def _write(
    options: argparse.Namespace, place: CalibrationContext, calibration: Calibration, fresh: JointCalibration
) -> int:
    if not agreed(options, f"write this to {place.path}?"):
        raise Rejected("nothing was written")
    after = write_entries(place, calibration, [fresh])
    next_steps(options, place, after)
    return DONE
