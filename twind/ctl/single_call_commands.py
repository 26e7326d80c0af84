"""Verbs of one call: mode, arm, disarm, reset, stop, mark, dump. Standard library only."""

import argparse
from typing import Any

from twind.client.errors import finding_lines
from twind.command_line.verb import (
    DONE,
    FunctionVerb,
    lease,
    no_arguments,
    observer,
    one_call,
    operator,
    show,
)


def _mode_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("mode", nargs="?", help="sim, mirror or live; without it the mode is shown")


def _mode(options: argparse.Namespace) -> int:
    if options.mode is None:
        with observer(options) as client:
            mode = client.call("GetStatus")["status"]["mode"]
    else:
        with operator(options) as client:
            mode = client.call("SetMode", mode=options.mode)["mode"]
    show(options, {"mode": mode}, mode)
    return DONE


def _arm_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")


def _arm(options: argparse.Namespace) -> int:
    with operator(options) as client, lease(client, take=options.take):
        answer = client.call("Arm")
    lines = [f"armed: {len(answer['joints'])} joints hold where they are"]
    lines += finding_lines(answer.get("warnings") or (), "warning")
    show(options, answer, "\n".join(lines))
    return DONE


def _reset_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("codes", nargs="*", metavar="CODE", help="faults to acknowledge (default: all)")


def _mark_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    begin = kinds.add_parser("begin", help="begin an episode")
    begin.add_argument("task", metavar="TASK", help="what the robot is to do")
    end = kinds.add_parser("end", help="end the episode")
    outcome = end.add_mutually_exclusive_group()
    outcome.add_argument("--success", dest="success", action="store_true", default=None, help="as wanted")
    outcome.add_argument("--failure", dest="success", action="store_false", help="not as wanted")
    note = kinds.add_parser("note", help="add a note to the recording")
    note.add_argument("text", metavar="TEXT", nargs="+", help="the note")


def _annotation(options: argparse.Namespace) -> dict[str, Any]:
    given = {key: getattr(options, key, None) for key in ("kind", "task", "success", "text")}
    return given | {"text": " ".join(given["text"]) if given["text"] else None}


def _dump_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", nargs="?", metavar="NAME", help="part of the file's name (default DUMP)")


MODE = FunctionVerb(
    "drive", "Show or change the mode: sim, mirror or live.", _mode_arguments, _mode, supports_remote=True
)
ARM = FunctionVerb("drive", "Switch torque on and hold the present pose.", _arm_arguments, _arm)
DISARM = FunctionVerb(
    "drive",
    "Settle to the rest pose, then switch torque off.",
    no_arguments,
    one_call("Disarm", lambda _, answer: f"disarmed: state {answer['state']}"),
)
RESET = FunctionVerb(
    "drive",
    "Acknowledge latched faults.",
    _reset_arguments,
    one_call(
        "Reset",
        lambda _, answer: f"state {answer['state']}",
        lambda options: {"codes": options.codes or None},
    ),
)
STOP = FunctionVerb(
    "drive",
    "Decelerate and hold.",
    no_arguments,
    one_call("Cancel", lambda _, answer: f"stopping: state {answer['state']}"),
    supports_remote=True,
)
MARK = FunctionVerb(
    "record",
    "Mark an episode in recordings: begin TASK, end, note TEXT.",
    _mark_arguments,
    one_call("Mark", lambda options, _: f"marked: {options.kind}", _annotation),
)
DUMP = FunctionVerb(
    "record",
    "Write the last half minute to a flight file and print its path.",
    _dump_arguments,
    one_call("DumpRecorder", lambda _, answer: str(answer["path"]), lambda options: {"name": options.name}),
)
