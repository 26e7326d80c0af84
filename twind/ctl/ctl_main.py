"""`twindctl`: finds the verb, runs it, turns what went wrong into words and an exit code.

Only the verb that is asked for is imported, so that a status stays cheap. Standard library only.
"""

import argparse
import os
import sys
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import Any

from twind.client import ClientError, Disconnected, NoDaemon, NotCarried
from twind.command_line.common_options import add_common_options
from twind.command_line.verb import DONE, NO_DAEMON, REFUSED, USAGE, Rejected, UsageError, Verb, complain

# name -> (where it is, what it does)
BUILT_IN = {
    "status": ("twind.ctl.status_command:STATUS", "what the robot and the daemon are doing"),
    "monitor": ("twind.ctl.monitor_command:MONITOR", "a live picture of everything; with --json a stream"),
    "watch": ("twind.ctl.watch_command:WATCH", "events as they happen"),
    "mode": ("twind.ctl.single_call_commands:MODE", "show or change where commands go: sim, mirror, live"),
    "arm": ("twind.ctl.single_call_commands:ARM", "torque on, holding where the robot is"),
    "disarm": ("twind.ctl.single_call_commands:DISARM", "settle to the rest pose, then torque off"),
    "estop": ("twind.ctl.estop:ESTOP", "stop now; --cut takes the torque off at once"),
    "reset": ("twind.ctl.single_call_commands:RESET", "acknowledge latched faults"),
    "stop": ("twind.ctl.single_call_commands:STOP", "decelerate and hold"),
    "mark": (
        "twind.ctl.single_call_commands:MARK",
        "say what the robot is doing: begin TASK, end, note TEXT",
    ),
    "dump": (
        "twind.ctl.single_call_commands:DUMP",
        "write the last half minute into a file, and print its path",
    ),
    "move": ("twind.ctl.motion_commands:MOVE", "move joints: JOINT=RAD ..."),
    "play": ("twind.ctl.motion_commands:PLAY", "play a trajectory file, or a motion of the robot by name"),
    "reload": (
        "twind.ctl.reload_commands:RELOAD",
        "have the daemon read its files again; what may change does",
    ),
    "parameters": (
        "twind.ctl.reload_commands:PARAMETERS",
        "show what is in force; KEY=VALUE sets it for this run",
    ),
    "check": ("twind.ctl.check_command", "check a robot file, or a trajectory against the gate"),
    "register": ("twind.ctl.device_commands:REGISTER", "read or write a register of one device"),
    "reboot": ("twind.ctl.device_commands:REBOOT", "restart one device"),
    "demo": ("twind.ctl.demo", "a virtual robot, the daemon, a motion, a refusal"),
}
GROUP = "twind.verbs"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb: 0 done, 1 refused, 2 usage, 3 no daemon."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    name = _verb_name(given)
    parser = _parser(name)
    verb = None if name is None else _find(name, parser)
    if verb is None:
        parser.parse_args(given)  # --help, or the message of what is wrong with it
        parser.error("name a verb; `twindctl --help` lists them")
    _add_verb(parser, str(name), verb)
    return _run(verb, parser.parse_args(given))


def _run(verb: Verb, options: argparse.Namespace) -> int:
    try:
        _check_remote(verb, options)
        return verb.run(options)
    except NoDaemon as error:
        complain(options, _sockets_gone(options, error))
        return NO_DAEMON
    except Disconnected as error:
        complain(options, error)
        return NO_DAEMON
    except (NotCarried, UsageError) as error:
        complain(options, error)
        return USAGE
    except (ClientError, Rejected) as error:
        complain(options, error)
        return REFUSED
    except BrokenPipeError:  # `twindctl watch | head`: what was asked for was given
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except KeyboardInterrupt:
        return 130


def _sockets_gone(options: argparse.Namespace, error: NoDaemon) -> NoDaemon:
    """The error, or one that names the daemon which still serves the folder without its sockets."""
    if not error.absent or options.remote is not None:
        return error
    from twind.ctl import serving  # only a failed connection pays for it

    found = serving.find(serving.folders(options.socket), patience=0.0)
    return NoDaemon(serving.described(found[0]), absent=True) if found else error


def _check_remote(verb: Verb, options: argparse.Namespace) -> None:
    """Raises UsageError: what the verb does is not done to a robot elsewhere."""
    if options.remote is None:
        return
    if not getattr(verb, "supports_remote", False):
        raise UsageError(f"{options.verb}: not with --remote; it is done beside the robot, or without one")
    if options.socket is not None:
        raise UsageError("--remote and --socket: one robot at a time")


def _verb_name(given: Sequence[str]) -> str | None:
    """The first word that is neither an option nor the value of `--socket`, `-i` or `--remote`."""
    skip = False
    for word in given:
        if skip:
            skip = False
        elif word in ("--socket", "-i", "--remote"):
            skip = True
        elif not word.startswith("-"):
            return word
    return None


def _parser(name: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="twindctl", description="Control and observe a twind daemon.")
    add_common_options(parser, None)
    if name is None or (name not in BUILT_IN and name not in _others()):
        lines = [f"  {known:<10} {text}" for known, (_, text) in BUILT_IN.items()]
        others = {known: point for known, point in _others().items() if known not in BUILT_IN}
        lines += [f"  {known:<10} {_headline(point.load())}" for known, point in others.items()]
        parser.formatter_class = argparse.RawDescriptionHelpFormatter
        parser.epilog = "verbs:\n" + "\n".join(lines) + "\n\n`twindctl VERB --help` shows more."
        parser.add_argument("verb", nargs="?", metavar="VERB")
    return parser


def _find(name: str, parser: argparse.ArgumentParser) -> Verb:
    if name in BUILT_IN:
        module, _, attribute = BUILT_IN[name][0].partition(":")
        found: Any = import_module(module)
        verb: Verb = getattr(found, attribute) if attribute else found
        return verb
    others = _others()
    if name not in others:
        known = ", ".join([*BUILT_IN, *(other for other in others if other not in BUILT_IN)])
        parser.error(f"no verb {name!r}; known: {known}")
    loaded: Verb = others[name].load()
    return loaded


def _others() -> dict[str, Any]:
    """Verbs that installed packages bring, by name."""
    from importlib.metadata import entry_points  # 20 ms that `status` need not pay

    found: Iterable[Any] = entry_points(group=GROUP)
    return {point.name: point for point in found}


def _headline(verb: Verb) -> str:
    """What an installed verb says of itself: the first line of its documentation."""
    return (verb.__doc__ or "").partition("\n")[0]


def _add_verb(parser: argparse.ArgumentParser, name: str, verb: Verb) -> None:
    text = BUILT_IN[name][1] if name in BUILT_IN else _headline(verb)
    under = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    child = under.add_parser(name, description=text, help=text)
    add_common_options(child, argparse.SUPPRESS)  # also after the verb
    verb.add_arguments(child)


if __name__ == "__main__":
    sys.exit(main())
