"""Table of `tune follow`: how far each joint was behind its goal, and the keys that fit it."""

import argparse
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

from twind.command_line.text_table import align_columns
from twind.command_line.verb import Rejected, show
from twind.observe.recording import open_recording
from twind.observe.tuning.follow_survey import JointLag, survey_follow, yaml_text

HEADINGS = ("joint", "moved", "p99", "worst", "over 0.2", "follow_rad", "follow_s", "note")


def show_follow(options: argparse.Namespace, path: Path) -> None:
    """Print the table of a recording. Raises Rejected."""
    recording = open_recording(path)
    if not recording.live.any():
        raise Rejected(f"{path}: no reading of mode live: a simulation shows no lag of servos")
    lags = survey_follow(recording)
    text = yaml_text(lags)
    data = {
        "file": str(path),
        "damage": recording.damage,
        "joints": [_plain(lag) for lag in lags],
        "yaml": text,
    }
    show(options, data, "\n".join(_lines(lags, text, recording.damage)))


def _lines(lags: list[JointLag], text: str, damage: str) -> list[str]:
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


def _plain(lag: JointLag) -> dict[str, Any]:
    """Return the row for `--json`; null: unknown, or nothing is proposed."""
    made = asdict(lag) | {"proposed": lag.proposed}
    return {key: None if value != value else value for key, value in made.items()}
