"""Compare the measured robot with its simulation, per joint.

Simulates the goals that the robot got, restarted from its measured state each second. Two figures for
position, velocity and effort: `spread`, the error divided by the spread of the measured motion, and
`unexpl.`, divided by what the delayed goal alone leaves unexplained. Reads a recording (.mcap, .flight) or a
daemon in mode live. Robot and identified model are those of the recording, or those that options name.
"""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twind.command_line.text_table import align_columns
from twind.command_line.verb import DONE, Rejected, UsageError, observer, show

if TYPE_CHECKING:
    from twind.gap.gap_figures import GapFigure, JointGap
    from twind.gap.motion_samples import MotionSamples
    from twind.twin.binding import Binding

group = "see"
supports_remote = True

HEADINGS = ("joint", "moved", "delay")
LONGEST = 120.0  # s of --live: all states of it are kept
FASTEST = 1000.0  # Hz asked for: the daemon sends each tick at most once
UNITS = {"position": ("mrad", 1e3), "velocity": ("rad/s", 1.0), "effort": ("N·m", 1.0)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("file", nargs="?", metavar="FILE", type=Path, help="an .mcap or .flight file")
    what.add_argument("--live", action="store_true", help="the daemon's robot, while it moves")
    parser.add_argument(
        "--seconds",
        type=float,
        default=30.0,
        metavar="S",
        help="of --live (default 30)",
    )
    parser.add_argument("--robot", metavar="NAME|FILE", help="robot to simulate (default: the recorded one)")
    parser.add_argument("--calibration", type=Path, metavar="FILE", help="its calibration")
    parser.add_argument("--identified", type=Path, metavar="FILE", help="its identified model")


def run(options: argparse.Namespace) -> int:
    """Exit code 0: the table is printed. Raises Rejected, UsageError."""
    if not 0.0 < options.seconds <= LONGEST:
        raise UsageError(f"--seconds {options.seconds:g}: above 0, at most {LONGEST:g}")
    if options.robot is None and (options.calibration or options.identified):
        raise UsageError("--calibration and --identified need --robot")
    from twind.exceptions import InvalidInput

    try:
        gaps, source, state = _live(options) if options.live else (*_of_file(options), "")
    except InvalidInput as error:
        raise Rejected(f"{options.file or 'the daemon'}: {error}") from None
    show(
        options,
        {"source": source, "joints": [asdict(each) for each in gaps], "total": _totals(gaps)},
        "\n".join(table_lines(gaps, state)),
    )
    return DONE


def _of_file(options: argparse.Namespace) -> "tuple[list[JointGap], str]":
    from twind.observe.measuring.measured_motion import recorded_motion, require_sent_goals
    from twind.observe.recording import open_recording

    recording = open_recording(options.file)
    if not recording.live.any():
        raise Rejected(f"{options.file}: no reading of mode live: without a driven robot there is no gap")
    require_sent_goals(recording.robot)
    samples = recorded_motion(recording)
    return _gaps(samples, _binding(options, recording.robot, recording.mjcf)), str(options.file)


def _live(options: argparse.Namespace) -> "tuple[list[JointGap], str, str]":
    from twind.observe.measuring.measured_motion import received_motion, require_sent_goals
    from twind.robot.recovery_steps import not_armed_text
    from twind.robot_client.require_armed import stopped_text

    with observer(options) as client:
        known = client.call("GetRobot")
        status = client.call("GetStatus")["status"]
        if stopped := stopped_text(status):
            raise Rejected(f"{stopped}; without a motion there is no gap")
        require_sent_goals(known["robot"])
        messages: list[Any] = []
        for message in client.stream("Monitor", topics=["state"], rate=FASTEST):
            messages.append(message)
            if message["mode"] != "live":
                raise Rejected(f"mode {message['mode']}: no goal reaches a robot, so there is no gap")
            if message["time"] - messages[0]["time"] >= options.seconds:
                break
    state = "" if status["armed"] else f"; {not_armed_text(status['state'])}"
    return _gaps(received_motion(messages), _binding(options, known["robot"], known["mjcf"])), "live", state


def _binding(options: argparse.Namespace, robot: Any, mjcf: str | None) -> "Binding":
    """Return the robot that the options name, else the recorded one. Raises InvalidInput."""
    from twind.gap.recorded_model import recorded_binding

    if options.robot is not None:
        return _named(options)
    if robot is None or mjcf is None:
        raise Rejected(f"{options.file}: it holds no robot: name it by --robot")
    return recorded_binding(robot, mjcf)


def _named(options: argparse.Namespace) -> "Binding":
    from dataclasses import replace

    from twind.config.calibration_file import load_calibration
    from twind.config.identified_file import load_identified
    from twind.config.robot_file import load_robot
    from twind.twin.binding import bind

    robot = load_robot(options.robot)
    calibration = None if options.calibration is None else load_calibration(options.calibration, robot)
    if options.identified is not None:
        robot = replace(robot, identified=load_identified(options.identified, robot))
    return bind(robot, calibration)


def _gaps(samples: "MotionSamples", binding: "Binding") -> "list[JointGap]":
    from twind.gap.gap_replay import GapReplay
    from twind.observe.measuring.measured_motion import control_period

    if samples.names != binding.robot.names:
        raise Rejected(
            f"its joints {', '.join(samples.names)} are not those of {', '.join(binding.robot.names)}"
        )
    period = control_period(samples)
    if period is None:
        raise Rejected(
            f"samples {samples.period:g} s apart: a gap needs at most 0.05 s; record at a higher rate"
        )
    return GapReplay(binding, period).gaps(samples)


def _totals(gaps: "list[JointGap]") -> dict[str, Any]:
    from twind.gap.gap_figures import total_gap

    found = {quantity: total_gap(gaps, quantity) for quantity in UNITS}
    return {quantity: None if each is None else asdict(each) for quantity, each in found.items()}


def table_lines(gaps: "list[JointGap]", state: str = "") -> list[str]:
    """Return a row for each joint and what the total means; the latter and `state` where none moved."""
    from twind.gap.gap_figures import total_gap

    head = [text for unit, _ in UNITS.values() for text in (unit, "spread", "unexpl.")]
    rows: list[tuple[str, ...]] = [(*HEADINGS, *head, "note")]
    for gap in gaps:
        cells = [cell for quantity in UNITS for cell in _cells(getattr(gap, quantity), quantity)]
        note = "" if gap.position else "no usable samples" if not gap.samples else "moved too little"
        rows.append((gap.joint, f"{gap.moved:.3f} rad", f"{gap.delay * 1e3:.0f} ms", *cells, note))
    total = total_gap(gaps)
    if not any(gap.position for gap in gaps):
        return [_meaning(total) + state]
    cells = [cell for quantity in UNITS for cell in _cells(total_gap(gaps, quantity), quantity)]
    rows.append(("total", "", "", *cells, ""))
    return [*align_columns(rows, (0, len(rows[0]) - 1)), _meaning(total)]


def _cells(figure: "GapFigure | None", quantity: str) -> tuple[str, str, str]:
    if figure is None:
        return "-", "-", "-"
    shares = (figure.nrmse_spread, figure.unexplained)
    texts = ["-" if share is None else f"{share:.1%}" for share in shares]
    return f"{figure.rms * UNITS[quantity][1]:.2f}", texts[0], texts[1]


def _meaning(total: "GapFigure | None") -> str:
    if total is None or total.nrmse_spread is None:
        return (
            "no joint moved enough to compare: meanwhile play a motion that moves each joint by some 0.1 rad"
        )
    text = f"the simulated positions miss the measured by {total.nrmse_spread:.1%} of their spread"
    if total.unexplained is None:
        return text
    return f"{text}, and by {total.unexplained:.0%} of what the delayed goal leaves unexplained"
