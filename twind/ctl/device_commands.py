"""Verbs on single devices: register, reboot. Standard library only."""

import argparse
from collections.abc import Mapping
from typing import Any

from twind.command_line.verb import DONE, FunctionVerb, UsageError, one_call, operator, show, write_register


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


def _device(options: argparse.Namespace) -> dict[str, Any]:
    return {"bus": options.bus, "id": options.id}


def _reboot_text(options: argparse.Namespace, answer: Mapping[str, Any]) -> str:
    lines = [f"{options.bus} id {options.id} restarted: state {answer['state']}"]
    lines += [f"  restored: {each}" for each in answer.get("restored") or ()]
    lines += [f"  differs: {each}" for each in answer.get("differing") or ()]
    return "\n".join(lines)


REGISTER = FunctionVerb("set up", "Read or write a register of one device.", _register_arguments, _register)
REBOOT = FunctionVerb("set up", "Restart one device.", _add_device, one_call("Reboot", _reboot_text, _device))
