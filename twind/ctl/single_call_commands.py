"""Verbs of one call: mode, arm, disarm, reset, stop, mark, dump, register, reboot. Standard library only."""

import argparse
import sys
from collections.abc import Mapping
from typing import Any

from twind.client.errors import finding_lines
from twind.command_line.joint_patterns import matching_joints
from twind.command_line.verb import (
    DONE,
    FunctionVerb,
    UsageError,
    lease,
    no_arguments,
    observer,
    one_call,
    operator,
    show,
    write_register,
)
from twind.robot.modes import Mode, RobotState
from twind.robot.recovery_steps import UNKNOWN, reported_torque

GOES_ON = (
    "\nthe daemon goes on disarming: the robot moves to its rest pose, then torque is off; "
    "`twindctl status` shows it, `twindctl estop --cut` switches torque off at once: the robot may fall"
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
    limp = "leave these without torque, to guide them by hand; * and ? are allowed"
    parser.add_argument("--limp", metavar="NAME,...", help=limp)


def _arm(options: argparse.Namespace) -> int:
    with operator(options) as client, lease(client, take=options.take):
        held = None
        if options.limp:
            names = [joint["name"] for joint in client.call("GetRobot")["robot"]["joints"]]
            limp = matching_joints(names, options.limp, "--limp")
            held = [name for name in names if name not in limp]
        answer = client.call("Arm", joints=held)
    lines = [f"armed: {len(answer['joints'])} joints hold where they are"]
    if held is not None:
        lines.append(f"limp: {', '.join(limp)}")
    lines += finding_lines(answer.get("warnings") or (), "warning")
    show(options, answer, "\n".join(lines))
    return DONE


def _disarm(options: argparse.Namespace) -> int:
    try:
        return one_call("Disarm", lambda _, answer: f"disarmed: {_state(answer)}")(options)
    except KeyboardInterrupt:
        print(GOES_ON, file=sys.stderr)
        raise


def _reset_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("codes", nargs="*", metavar="CODE", help="faults to acknowledge (default: all)")


def _reset(options: argparse.Namespace) -> int:
    with operator(options) as client:
        answer = client.call("Reset", codes=options.codes or None)
        status = client.call("GetStatus")["status"]
    torque = ""
    if status["mode"] == Mode.LIVE and answer["state"] != RobotState.DISCONNECTED:
        torque = f"; {UNKNOWN}" if reported_torque(status) is None else ""
    show(options, answer, f"reset: done; {_state(answer)}{torque}")
    return DONE


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


def _annotation(options: argparse.Namespace) -> dict[str, object]:
    given = {key: getattr(options, key, None) for key in ("kind", "task", "success", "text")}
    return given | {"text": " ".join(given["text"]) if given["text"] else None}


def _marked(options: argparse.Namespace, answer: Mapping[str, Any]) -> str:
    # An older daemon does not say whether an episode was open.
    none = options.kind == "end" and answer.get("was_open") is False
    return f"marked: {options.kind}" + ("; no episode was open: `twindctl mark begin TASK`" if none else "")


def _dump_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", nargs="?", metavar="NAME", help="part of the file's name (default DUMP)")


def _state(answer: Mapping[str, str]) -> str:
    """Format the state; in mode sim no robot is connected, which is no fault."""
    state = answer["state"]
    return "no robot is connected" if state == RobotState.DISCONNECTED else f"state {state}"


MODE = FunctionVerb(
    "drive", "Show or change the mode: sim, mirror or live.", _mode_arguments, _mode, supports_remote=True
)
ARM = FunctionVerb("drive", "Switch torque on and hold the present pose.", _arm_arguments, _arm)
DISARM = FunctionVerb(
    "drive",
    "Settle to the rest pose, then switch torque off.",
    no_arguments,
    _disarm,
)
RESET = FunctionVerb(
    "drive",
    "Acknowledge latched faults.",
    _reset_arguments,
    _reset,
)
STOP = FunctionVerb(
    "drive",
    "Decelerate and hold.",
    no_arguments,
    one_call("Cancel", lambda _, answer: f"stopping: {_state(answer)}"),
    supports_remote=True,
)
MARK = FunctionVerb(
    "record",
    "Mark an episode in recordings: begin TASK, end, note TEXT.",
    _mark_arguments,
    one_call("Mark", _marked, _annotation),
)
DUMP = FunctionVerb(
    "record",
    "Write the last half minute to a flight file and print its path.",
    _dump_arguments,
    one_call("DumpRecorder", lambda _, answer: str(answer["path"]), lambda options: {"name": options.name}),
)


def _parse_integer(text: str) -> int:
    """12, -3, 0x1F. Raises ArgumentTypeError."""
    try:
        return int(text, 0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number") from None


def _register_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=["read", "write"], help="what to do")
    _add_device(parser)
    parser.add_argument("name", help="as the vendor's control table spells it, or its address")
    parser.add_argument("value", nargs="?", type=_parse_integer, help="to write")
    parser.add_argument("--take", action="store_true", help="EEPROM: take the lease from its present holder")


def _register(options: argparse.Namespace) -> int:
    where = _device(options) | {"name": options.name}
    if (options.action == "write") != (options.value is not None):
        raise UsageError("write takes a VALUE, read takes none")
    with operator(options) as client:
        if options.action == "read":
            answer = client.call("ReadRegister", **where)
        else:
            answer = write_register(client, take=options.take, **where, value=options.value)
    register = answer["register"]
    address = f"address {register['address']}, {register['size']} bytes"
    show(options, answer, f"{register['name']} = {register['value']} ({address})")
    return DONE


def _add_device(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bus", help="bus of the device, as the robot file names it")
    parser.add_argument("id", type=int, help="id of the device")


def _device(options: argparse.Namespace) -> dict[str, object]:
    return {"bus": options.bus, "id": options.id}


def _reboot_text(options: argparse.Namespace, answer: Mapping[str, Any]) -> str:
    lines = [f"{options.bus} id {options.id} restarted: state {answer['state']}"]
    lines += [f"  restored: {each}" for each in answer.get("restored") or ()]
    lines += [f"  differs: {each}" for each in answer.get("differing") or ()]
    return "\n".join(lines)


REGISTER = FunctionVerb("set up", "Read or write a register of one device.", _register_arguments, _register)
REBOOT = FunctionVerb("set up", "Restart one device.", _add_device, one_call("Reboot", _reboot_text, _device))
