"""One recording of `twindctl teach`, from the first question to the file. Blocks."""

import argparse
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from twind.client import Client, ClientError
from twind.client.move_duration import slow_duration
from twind.command_line.joint_patterns import matching_joints
from twind.command_line.keep_torque_off import limp
from twind.command_line.progress import ProgressLine
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.trajectory_files import new_motion, write_trajectory
from twind.command_line.verb import DONE, REFUSED, Rejected, UsageError, observer, operator, show
from twind.ctl.hint_options import command_hint
from twind.ctl.teaching.hand_recorder import HandRecorder
from twind.ctl.teaching.key_input import KeyInput
from twind.ctl.teaching.taught_motion import (
    TaughtMotion,
    VerdictMessage,
    passed_by_gate,
    taught_motion,
)
from twind.ctl.teaching.teach_outcome import TeachOutcome
from twind.robot.modes import Mode
from twind_drivers.clock import MonotonicClock

SHOWN = 5  # names in one line
SILENCE = 2.0  # s without a message after which the daemon counts as gone


def teach(options: argparse.Namespace, keys: KeyInput) -> int:
    """Record, write and report. Returns the exit code. Raises ClientError, Rejected, UsageError."""
    with operator(options) as client:
        robot = client.call("GetRobot")["robot"]
        names = [joint["name"] for joint in robot["joints"]]
        joints = matching_joints(names, options.joints or "*", "--joints")
        mode = _require_calibrated(client, joints)
        folder = robot.get("motions")
        path = new_motion(options.motion, Path(folder) if isinstance(folder, str) else None)
        _require_place(path, options.force)
        recorder = _record(options, client, keys, joints)
        motion, verdict = _judged(client, _motion(recorder, options.bound, robot["poses"]["rest"]))
    accepted = verdict is not None and not verdict["refusals"]
    # A motion that was accepted is not given up for one that the gate refuses: that goes beside it.
    written = _write(path, motion.trajectory(), options.force and accepted)
    outcome = TeachOutcome(motion, verdict, recorder, written, mode)
    name = options.motion if written == path else str(written)
    show(options, outcome.as_sent(), "\n".join(outcome.lines(command_hint(options), name)))
    return DONE if accepted and not recorder.cut_off and written == path else REFUSED


def _require_calibrated(client: Client, joints: list[str]) -> str:
    """Return the mode of the daemon. Raises Rejected: a joint's zero is unknown, so is where it is."""
    answer = client.call("GetStatus", joints=True)
    raw = [row["name"] for row in answer["joints"] if row["name"] in joints and not row["calibrated"]]
    mode: str = answer["status"]["mode"]
    if raw and mode != Mode.SIM:
        more = f" and {len(raw) - SHOWN} more" if len(raw) > SHOWN else ""
        raise Rejected(
            f"{', '.join(raw[:SHOWN])}{more}: not calibrated, so what a hand shows is not where it is: first "
            "`twindctl calibrate sweep`, then `twindctl calibrate zero`"
        )
    return mode


def _require_place(path: Path, force: bool) -> None:
    """Check, before anyone guides the robot, that the file can be written. Raises Rejected."""
    if path.exists() and not force:
        raise Rejected(f"{path} exists: --force replaces it, or choose another name")
    parent = path.parent if path.parent.exists() else path.parent.parent
    if not os.access(parent, os.W_OK):
        raise Rejected(f"{parent}: no such folder, or no right to write there; give a path, as ./{path.name}")


def _record(options: argparse.Namespace, client: Client, keys: KeyInput, joints: list[str]) -> HandRecorder:
    """Return the samples of one recording. A daemon that is lost ends it. Raises ClientError before it."""
    rate = float(client.call("GetStatus")["status"]["loop"]["rate_hz"])
    alone = joints if options.joints else None
    with (
        limp(client, MonotonicClock(), take=options.take, joints=alone) as keep,
        observer(options) as watching,
        closing(watching.stream("Monitor", topics=["state"], rate=rate)) as stream,
        catch_stop_signals() as stop,
        ProgressLine(options, options.verb) as progress,
    ):
        watching.timeout = SILENCE
        if options.seconds is None:
            print(f"{len(joints)} joints are limp. Enter begins, Enter or Ctrl-C ends.", file=sys.stderr)
            _wait_for_start(stream, keep, keys, stop)
        recorder = HandRecorder(joints, 1.0 / rate, options.seconds)
        try:
            for state in stream:
                recorder.take(state)
                if recorder.ended or stop.is_set() or keys.pressed():
                    break
                progress.update(f"{recorder.seconds:.1f} s recorded; Enter ends it")
                keep()
        except ClientError as error:
            recorder.cut(str(error))
        return recorder


def _wait_for_start(
    stream: Iterator[Any], keep: Callable[[], None], keys: KeyInput, stop: threading.Event
) -> None:
    """Wait for Enter. Raises KeyboardInterrupt, UsageError: no key can come, ClientError."""
    for _ in stream:
        if keys.pressed():
            return
        if stop.is_set():
            raise KeyboardInterrupt
        if keys.ended:
            raise UsageError("standard input has ended, so Enter cannot begin: give --seconds")
        keep()


def _motion(recorder: HandRecorder, bound: float, rest: Mapping[str, float]) -> TaughtMotion:
    """Return the motion as the hand made it. Raises Rejected: there are no samples, or nothing moved.

    Its way to the start is slow from where the hand ended and from the rest pose.
    """
    hand = recorder.path()
    if hand is None:
        raise Rejected(f"no path was recorded: {recorder.ended or 'it was ended at once'}")
    first, last = (dict(zip(recorder.joints, hand.position[row].tolist(), strict=True)) for row in (0, -1))
    lead = max(slow_duration(first, start) for start in (last, rest))
    motion = taught_motion(recorder.joints, hand, bound, lead)
    if motion.still:
        raise Rejected(
            f"no file is written: no joint moved by more than {bound:g} rad: guide them while it records"
        )
    return motion


def _judged(client: Client, motion: TaughtMotion) -> tuple[TaughtMotion, VerdictMessage | None]:
    """Return the motion as the gate passes it, and the verdict; None where the daemon gives none."""
    try:
        return passed_by_gate(motion, lambda path: client.call("Check", trajectory=path)["verdict"])
    except ClientError as error:  # what was recorded is written all the same
        print(f"not checked: {error}", file=sys.stderr)
        return motion, None


def _write(path: Path, trajectory: dict[str, Any], force: bool) -> Path:
    """Write the motion and return its path: a temporary file where this one cannot be written after all."""
    try:
        write_trajectory(path, trajectory, replace=force)
        return path
    except OSError as error:
        print(f"{path}: {error.strerror or error}", file=sys.stderr)
    spare = Path(tempfile.mkdtemp(prefix="twind-teach-")) / path.name
    write_trajectory(spare, trajectory, replace=False)
    return spare
