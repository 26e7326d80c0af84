"""Steps of `twindctl identify`: read or make the motion, fit, print, write."""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from twind.command_line.verb import Rejected, UsageError, observer, show
from twind.config.calibration_file import load_calibration
from twind.config.identified_file import save_identified
from twind.config.identified_spec import IdentifiedModel
from twind.config.robot_file import load_robot
from twind.exceptions import InvalidInput
from twind.gap.gap_figures import JointGap
from twind.gap.gap_replay import resample
from twind.gap.motion_samples import MotionSamples
from twind.identification.carried_robot import require_carried
from twind.identification.identified_robot import DataOrigin, RobotIdentification, identify_robot
from twind.identification.identified_table import model_lines
from twind.identification.live_excitation import excite_robot
from twind.identification.pendulum_fit import fit_pendulum, identified_pendulum, replay_error
from twind.identification.pendulum_recordings import load_pendulum
from twind.observe.measuring.measured_motion import (
    control_period,
    received_motion,
    recorded_motion,
    require_sent_goals,
)
from twind.observe.recording import open_recording
from twind.robot_client.robot import Robot
from twind.twin.binding import Binding, bind
from twind.twin.simulation import hush
from twind.version import __version__


def identify_files(options: argparse.Namespace, paths: Sequence[Path]) -> None:
    """Identify from recordings of mode live. Raises Rejected, UsageError."""
    recordings = [open_recording(path) for path in paths]
    first = recordings[0]
    motions = [recorded_motion(each) for each in recordings]
    source = ", ".join(path.name for path in paths)
    _identify(options, motions, source, first.robot, first.mjcf, None)


def identify_live(options: argparse.Namespace, joints: Sequence[str]) -> None:
    """Identify from a motion that this makes now. Raises Rejected, UsageError, ClientError."""
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
    try:
        require_sent_goals(known["robot"])  # before the robot moves for minutes
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    with Robot(options.socket, take=options.take) as robot:
        listener = observer(options)
        messages = excite_robot(robot, listener, known["robot"], joints or robot.names, options.amplitude)
    if not messages:
        raise Rejected(
            "the gate refused every motion: is the robot armed, in mode live, clear of its limits?"
        )
    _identify(options, [received_motion(messages)], "live", known["robot"], known["mjcf"], joints or None)


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
    motions: Sequence[MotionSamples],
    source: str,
    robot: Any,
    mjcf: str | None,
    joints: Sequence[str] | None,
) -> None:
    """Fit, print and write. `robot`, `mjcf`: the recorded ones, where the options name none."""
    hush()
    try:
        require_sent_goals(robot)
        found, path = _fit(options, motions, source, (robot, mjcf), joints)
    except InvalidInput as error:
        raise Rejected(f"{source}: {error}") from None
    lines = [*model_lines(found.model), *_gap_lines(found)]
    if path is not None:
        lines.append(f"written to {path}; the daemon takes it at its next start")
    show(
        options, {"model": msgspec.to_builtins(found.model), "written": path and str(path)}, "\n".join(lines)
    )


def _fit(
    options: argparse.Namespace,
    motions: Sequence[MotionSamples],
    source: str,
    recorded: tuple[Any, str | None],
    joints: Sequence[str] | None,
) -> tuple[RobotIdentification, Path | None]:
    if options.write and (options.robot is None or options.calibration is None):
        raise UsageError(
            "--write needs --robot and --calibration: the model is written beside the calibration"
        )
    period = control_period(motions[0])
    if period is None:
        raise InvalidInput("its samples are more than 0.05 s apart: record at a higher rate")
    named = options.robot or (recorded[0] or {}).get("path")
    if named is None:
        raise UsageError("the recording holds no robot: name it by --robot")
    plain_robot = replace(load_robot(named), identified=None)
    calibration = options.calibration and load_calibration(options.calibration, plain_robot)

    def rebind(model: IdentifiedModel) -> Binding:
        return bind(replace(plain_robot, identified=model), calibration)

    plain = bind(plain_robot, calibration)
    for each in motions:
        if each.names != plain.robot.names:
            raise InvalidInput(
                f"its joints are not those of {plain.robot.name}: {', '.join(plain.robot.names)}"
            )
    origin = DataOrigin(_now(), f"twind {__version__}", source)
    found = identify_robot(plain, [resample(each, period) for each in motions], origin, rebind, joints)
    return found, save_identified(found.model, options.calibration) if options.write else None


def _gap_lines(found: RobotIdentification) -> list[str]:
    lines = ["error of the whole robot's simulation on the held-out quarter, before and after:"]
    for before, after in zip(found.before, found.after, strict=True):
        if before.joint in found.model.joints:
            lines.append(f"  {before.joint}: {_share(before)} -> {_share(after)}")
    if found.still:
        lines.append(f"not identified, moved too little: {', '.join(found.still)}")
    return lines


def _share(gap: JointGap) -> str:
    figure = gap.position
    if figure is None or figure.nrmse_spread is None:
        return "moved too little"
    rest = "" if figure.unexplained is None else f" of the spread, {figure.unexplained:.0%} unexplained"
    return f"{figure.nrmse_spread:.1%}{rest}"


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
