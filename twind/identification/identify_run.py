"""Steps of `twindctl identify`: read or make the motion, fit, print, write."""

import argparse
import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from twind.command_line.phase_lines import PhaseLines
from twind.command_line.verb import Rejected, UsageError, observer, show
from twind.config.identified_file import identified_path, save_identified
from twind.config.identified_spec import IdentifiedModel
from twind.exceptions import InvalidInput
from twind.gap.gap_figures import JointGap
from twind.gap.gap_replay import resample
from twind.gap.motion_samples import MotionSamples
from twind.identification.carried_robot import require_carried
from twind.identification.fit_files import FitFiles, load_fit_files, require_place
from twind.identification.identified_robot import DataOrigin, RobotIdentification, identify_robot
from twind.identification.identified_table import model_lines
from twind.identification.live_excitation import excite_robot
from twind.identification.pendulum_fit import fit_pendulum, identified_pendulum, replay_error
from twind.identification.pendulum_recordings import load_pendulum
from twind.new_file import unwritten
from twind.observe.measuring.measured_motion import (
    control_period,
    received_motion,
    recorded_motion,
    require_sent_goals,
)
from twind.observe.recording import open_recording
from twind.robot_client.robot import Robot
from twind.twin.simulation import hush
from twind.version import __version__

WIDEST = 1.5  # rad, of an amplitude


def identify_files(options: argparse.Namespace, paths: Sequence[Path]) -> None:
    """Identify from recordings of mode live. Raises Rejected, UsageError, ConfigError."""
    require_place(options)
    recordings = [open_recording(path) for path in paths]
    motions = [recorded_motion(each) for each in recordings]
    source = ", ".join(path.name for path in paths)
    files = _files(options, recordings[0].robot, source)
    _identify(options, files, motions, source, None)


def identify_live(options: argparse.Namespace, joints: Sequence[str]) -> None:
    """Identify from a motion that this makes now. Raises Rejected, UsageError, ConfigError, ClientError."""
    if not 0.0 < options.amplitude <= WIDEST:
        raise UsageError(f"--amplitude {options.amplitude:g}: above 0, at most {WIDEST:g} rad")
    require_place(options)
    with observer(options) as client:
        known = client.call("GetRobot")
        mode = client.call("GetStatus")["status"]["mode"]
    names = [each["name"] for each in known["robot"]["joints"]]
    strange = [name for name in joints if name not in names]
    if strange:
        raise Rejected(f"the robot has no joint {strange[0]!r}; it has {', '.join(names)}")
    if mode != "live":
        raise Rejected(
            f"the daemon is in mode {mode}, in which the robot does not move: start it with --mode live"
        )
    require_carried(known["robot"], "the excitation of `identify --live`")
    files = _files(options, known["robot"], "the daemon's robot", names)
    with Robot(options.socket, take=options.take) as robot:
        if not robot.armed:
            raise Rejected("a robot is identified armed: `twindctl arm`")
        listener = observer(options)
        report = PhaseLines(options, "identify")
        wanted = joints or robot.names
        messages = excite_robot(robot, listener, known["robot"], wanted, options.amplitude, report)
    if not messages:
        raise Rejected(
            "no joint moved: the gate refused every path, or all are too warm; give it room, let it cool, or "
            "lower --amplitude"
        )
    _identify(options, files, [received_motion(messages)], "live", joints or None)


def _files(
    options: argparse.Namespace, described: Any, source: str, names: Sequence[str] | None = None
) -> FitFiles:
    """Load the files of a fit of a described robot with joints `names`. Raises Rejected, as `load_fit_files`.

    A live motion takes minutes: what is wrong with them is reported before it begins.
    """
    hush()
    try:
        require_sent_goals(described)
        files = load_fit_files(options, described)
        if names is not None:
            files.require_joints(names)
    except InvalidInput as error:
        raise Rejected(f"{source}: {error}") from None
    return files


def identify_pendulum(options: argparse.Namespace, paths: Sequence[Path]) -> None:
    """Identify one servo that swings a mass. Raises Rejected."""
    if options.write:
        raise UsageError("--write: a CSV names no joint, so there is no robot to write it for")
    pairs = {"mass_kg": options.mass, "length_m": options.length, "kp": options.kp}
    given = {key: value for key, value in pairs.items() if value is not None}
    try:
        train, judge = ([load_pendulum(path, given) for path in each] for each in (paths, options.judge))
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    fit = fit_pendulum(train)
    joint = identified_pendulum(fit)
    seconds = float(sum(each.time[-1] for each in train))
    model = IdentifiedModel("servo", _now(), f"twind {__version__}", "CSV", seconds, 0.0, {"servo": joint})
    lines = model_lines(model)
    errors = {}
    for title, recordings in (("fit", train), ("held out", judge)):
        for each, miss in zip(
            recordings, replay_error(recordings, fit.values) if recordings else [], strict=True
        ):
            errors[each.name] = float(miss)
            lines.append(f"{title}: {each.name}: mean position error {math.degrees(miss):.2f}°")
    show(options, {"model": msgspec.to_builtins(model), "errors_rad": errors}, "\n".join(lines))


def _identify(
    options: argparse.Namespace,
    files: FitFiles,
    motions: Sequence[MotionSamples],
    source: str,
    joints: Sequence[str] | None,
) -> None:
    """Fit, print and write."""
    try:
        found = _fit(options, files, motions, source, joints)
    except InvalidInput as error:
        raise Rejected(f"{source}: {error}") from None
    path = None
    failed = ""
    if options.write:
        try:
            path = save_identified(found.model, options.calibration)
        except OSError as error:
            failed = f"{identified_path(options.calibration)} cannot be written: {unwritten(error)}"
    lines = [*model_lines(found.model), *_gap_lines(found)]
    if path is not None:
        lines.append(f"written to {path}; the daemon takes it at its next start")
    show(
        options, {"model": msgspec.to_builtins(found.model), "written": path and str(path)}, "\n".join(lines)
    )
    if failed:  # after the figures: they took minutes of motion
        raise Rejected(failed)


def _fit(
    options: argparse.Namespace,
    files: FitFiles,
    motions: Sequence[MotionSamples],
    source: str,
    joints: Sequence[str] | None,
) -> RobotIdentification:
    period = control_period(motions[0])
    if period is None:
        raise InvalidInput("its samples are more than 0.05 s apart: record at a higher rate")
    for each in motions:
        files.require_joints(each.names)
    origin = DataOrigin(_now(), f"twind {__version__}", source)
    samples = [resample(each, period) for each in motions]
    report = PhaseLines(options, "identify")
    return identify_robot(files.plain, samples, origin, files.bound_with, joints, report)


def _gap_lines(found: RobotIdentification) -> list[str]:
    lines = ["error of the whole robot's simulation on the held-out quarter, before and after:"]
    for before, after in zip(found.before, found.after, strict=True):
        if before.joint in found.model.joints:
            worse = "; worse" if _grew(before, after) else ""
            lines.append(f"  {before.joint}: {_share(before)} -> {_share(after)}{worse}")
    if found.still:
        lines.append(f"not identified, moved too little: {', '.join(found.still)}")
    return lines


def _grew(before: JointGap, after: JointGap) -> bool:
    """Check whether the error grew, by the spread of the motion."""
    figures = [None if gap.position is None else gap.position.nrmse_spread for gap in (before, after)]
    return figures[0] is not None and figures[1] is not None and figures[1] > figures[0]


def _share(gap: JointGap) -> str:
    figure = gap.position
    if figure is None or figure.nrmse_spread is None:
        return "moved too little"
    rest = "" if figure.unexplained is None else f" of the spread, {figure.unexplained:.0%} unexplained"
    return f"{figure.nrmse_spread:.1%}{rest}"


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
