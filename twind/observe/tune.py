"""Propose values of the robot file from a recording.

`follow`: how far each joint was behind its goal, and the keys follow_rad and follow_s that fit it, with a
margin of a quarter (FOLLOW_ERR). Reads an .mcap or .flight file of mode live. Faults are left out and
reported: a blocked joint is no reason for a wider bound. No file is written.
"""

import argparse
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twind.command_line.text_table import align_columns
from twind.command_line.verb import DONE, Rejected, show

if TYPE_CHECKING:
    from twind.observe.tuning.follow_survey import JointLag

group = "set up"

HEADINGS = ("joint", "moved", "p99", "worst", "over 0.2", "follow_rad", "follow_s", "note")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("what", choices=["follow"], help="values to propose")
    parser.add_argument("file", metavar="FILE", type=Path, help="an .mcap or .flight file")


def run(options: argparse.Namespace) -> int:
    """Exit code 0: the table is printed. Raises Rejected."""
    from twind.observe.recording import open_recording
    from twind.observe.tuning.follow_survey import survey_follow, yaml_text

    recording = open_recording(options.file)
    if not recording.live.any():
        raise Rejected(f"{options.file}: no reading of mode live: a simulation shows no lag of servos")
    lags = survey_follow(recording)
    text = yaml_text(lags)
    data = {
        "file": str(options.file),
        "damage": recording.damage,
        "joints": [_plain(lag) for lag in lags],
        "yaml": text,
    }
    show(options, data, "\n".join(_lines(lags, text, recording.damage)))
    return DONE


def _lines(lags: "list[JointLag]", text: str, damage: str) -> list[str]:
    rows = [
        (
            lag.joint,
            f"{lag.moved:.2f}",
            _number(lag.p99),
            _number(lag.worst),
            f"{lag.above:.2f} s",
            "" if lag.rad is None else f"{lag.rad:g}",
            "" if lag.seconds is None else f"{lag.seconds:g}",
            lag.note,
        )
        for lag in lags
    ]
    last = (
        ["add to the joints of the robot file:", text] if text else ["the default fits the joints that moved"]
    )
    title = "rad behind the goal, beyond 0.03 s of its speed"
    broken = [f"warning: the file is not whole: {damage}"] if damage else []
    return [title, *align_columns([HEADINGS, *rows], (0, len(HEADINGS) - 1)), *broken, *last]


def _number(value: float) -> str:
    return f"{value:.3f}" if isfinite(value) else "?"


def _plain(lag: "JointLag") -> dict[str, Any]:
    """Return the row for `--json`; null: unknown, or nothing is proposed."""
    made = asdict(lag) | {"proposed": lag.proposed}
    return {key: None if value != value else value for key, value in made.items()}
