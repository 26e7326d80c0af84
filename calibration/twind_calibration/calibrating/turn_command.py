"""`twindctl calibrate turn`: tells the daemon on which turn joints stand, by a pose or an endstop. Blocks."""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

from twind.client import Client
from twind.command_line.verb import DONE, Rejected, UsageError, calibrating, operator
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator, slots
from twind_calibration.calibrating.calibration_context import CalibrationContext, ground
from twind_calibration.calibrating.endstop_command import drive_to_stop, plan_endstop
from twind_calibration.calibrating.entry_writer import agreed, require_terminal
from twind_calibration.calibrating.zero_command import parse_angles
from twind_calibration.rejection_hints import with_hints


@with_hints
def turn(options: argparse.Namespace) -> int:
    """Return exit code 0 when the turns are known. Raises Rejected, UsageError, ClientError."""
    with operator(options) as client:
        return _turn(options, client)


def _turn(options: argparse.Namespace, client: Client) -> int:
    place = ground(options, client)
    every = slots(place.robot)
    names = place.select_actuators(options.joints, [slot.name for slot in every])
    chosen = [slot for slot in every if slot.name in names]
    require_terminal(options)
    if options.endstop:
        _by_endstop(options, client, place, chosen)
    elif options.pose is None and not options.at:
        raise UsageError("say where the joints stand: --pose NAME, --at JOINT=RAD, or --endstop")
    else:
        _by_pose(options, client, parse_angles(options, place, chosen), chosen)
    _show(options, client, chosen)
    return DONE


def _by_pose(
    options: argparse.Namespace,
    client: Client,
    angles: Mapping[str, float],
    chosen: Sequence[CalibrationActuator],
) -> None:
    """Take the turn on which each joint stands nearest to its angle (rad)."""
    stands = ", ".join(f"{name} at {angle:+.3f} rad" for name, angle in angles.items())
    if not agreed(options, f"stands {stands}: take the turn of that?"):
        raise Rejected("nothing was changed")
    with calibrating(client, take=options.take):
        client.call(
            "LocateJoints",
            joint_names=[slot.joint.name for slot in chosen],
            positions=[angles[slot.name] for slot in chosen],
        )


def _by_endstop(
    options: argparse.Namespace,
    client: Client,
    place: CalibrationContext,
    chosen: Sequence[CalibrationActuator],
) -> None:
    """Drive the joint against its stop, and away from it as far as proves its turn."""
    if len(chosen) != 1:
        raise UsageError(f"--endstop drives one joint at a time, not {len(chosen)}")
    touch = replace(plan_endstop(options, place, chosen[0].name), proves_turn=True)
    calibration = place.calibration()
    entry = None if calibration is None else calibration.by_name.get(touch.slot.name)
    if entry is None:
        raise Rejected(f"{touch.slot.name} is not calibrated: `twindctl calibrate sweep`, then `zero`, first")
    drive_to_stop(options, client, place, touch, entry)


def _show(options: argparse.Namespace, client: Client, chosen: Sequence[CalibrationActuator]) -> None:
    """Show where the joints stand. Raises Rejected: a turn is still unknown."""
    joints = {each["name"]: each for each in client.call("GetStatus", joints=True)["joints"]}
    for slot in chosen:
        found = joints[slot.joint.name]
        if found["position"] is None:
            raise Rejected(f"the turn of {slot.name} is still unknown: `twindctl status` says why")
        if options.json:
            print(json.dumps({"joint": slot.name, "position": found["position"]}), flush=True)
        else:
            print(f"{slot.name}: its turn is known, it stands at {found['position']:+.3f} rad", flush=True)
