"""`twindctl`: find the verb, run it, turn an error into a message and an exit code.

Only the verb of the command line is imported, so that a status stays cheap. Standard library only.
"""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence

from twind.client import ClientError, Disconnected, NoDaemon, NotCarried
from twind.command_line.common_options import add_common_options
from twind.command_line.verb import (
    DONE,
    EXIT_CODES,
    INTERRUPTED,
    NO_DAEMON,
    REFUSED,
    USAGE,
    Rejected,
    UsageError,
    Verb,
    complain,
    discard_output,
    help_text,
)
from twind.ctl.verb_catalog import find_verb, grouped_verbs, summary, verb_names
from twind.version import __version__

ONLY_SHOWN = frozenset({"see", "record", "connect"})  # groups of verbs whose work is their output


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb. Returns one of EXIT_CODES."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = command_parser(words)
    options = parser.parse_args(words)
    verb = find_verb(options.verb) if options.verb else None
    if verb is None:
        parser.error("name a verb; `twindctl --help` lists them")
    return _run(verb, options)


def command_parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """The parser of a command line, with the arguments of its verb alone. Imports no other verb.

    An unknown verb ends the process with the usage.
    """
    name = _verb_name(words)
    verb = None if name is None else find_verb(name)
    parser = _program_parser()
    if name is not None and verb is not None:
        _add_verbs(parser, {name: verb})
        return parser
    parser.add_argument("verb", nargs="?", metavar="VERB", help="what to do: one of the verbs below")
    if name is not None:
        parser.error(f"no verb {name!r}; known: {', '.join(verb_names())}")
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _verb_list()
    return parser


def full_parser() -> argparse.ArgumentParser:
    """The parser of all verbs, for completion and manuals. Imports every verb."""
    parser = _program_parser()
    _add_verbs(parser, {name: verb for verbs in grouped_verbs().values() for name, verb in verbs.items()})
    return parser


def _run(verb: Verb, options: argparse.Namespace) -> int:
    try:
        _check_remote(verb, options)
        return verb.run(options)
    except NoDaemon as error:
        _complain(options, _sockets_gone(options, error))
        return NO_DAEMON
    except Disconnected as error:
        _complain(options, error)
        return NO_DAEMON
    except (NotCarried, UsageError) as error:
        _complain(options, error)
        return USAGE
    except (ClientError, Rejected) as error:
        _complain(options, error)
        return REFUSED
    except BrokenPipeError:
        discard_output()
        if verb.group in ONLY_SHOWN:  # `twindctl watch | head`: what was asked for was given
            return DONE
        complain(options, Rejected("not completed: its output is no longer read"))
        return REFUSED
    except OSError as error:
        from twind.new_file import UNWRITABLE, unwritten  # only a failed write pays for it

        if error.errno not in UNWRITABLE:
            raise
        _complain(options, Rejected(f"{error.filename or 'a file'} cannot be written: {unwritten(error)}"))
        return REFUSED
    except KeyboardInterrupt:
        return INTERRUPTED


def _complain(options: argparse.Namespace, error: Exception) -> None:
    """Print an error; commands in it reach the daemon of this call."""
    if options.socket is None:
        complain(options, error)
        return
    from twind.ctl.hint_options import command_hint  # only an error of a named daemon pays for it

    complain(options, error, command_hint(options).prose)


def _sockets_gone(options: argparse.Namespace, error: NoDaemon) -> NoDaemon:
    """The error, or one that names the daemon which still serves the folder without its sockets."""
    if not error.absent or options.remote is not None:
        return error
    from twind.ctl import lost_socket_daemon  # only a failed connection pays for it

    folders = lost_socket_daemon.folders(options.socket)
    if error.where and os.path.normpath(os.path.dirname(error.where)) not in map(os.path.normpath, folders):
        return error  # of another daemon, such as the leader of `follow`
    found = lost_socket_daemon.find(folders, patience=0.0)
    return NoDaemon(lost_socket_daemon.described(found[0]), absent=True) if found else error


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


def _program_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="twindctl", description="Control and observe a twind daemon.")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    add_common_options(parser, None)
    return parser


def _verb_list() -> str:
    """All verbs by their groups, and the exit codes."""
    blocks = []
    for group, verbs in grouped_verbs().items():
        lines = [f"  {name:<11} {summary(verb)}" for name, verb in verbs.items()]
        blocks.append("\n".join([f"{group}:", *lines]))
    codes = "\n".join(f"  {code:<11} {meaning}" for code, meaning in EXIT_CODES.items())
    blocks.append(f"exit codes:\n{codes}")
    blocks.append("The options above may also follow the verb. `twindctl VERB --help` shows those of a verb.")
    return "\n\n".join(blocks)


def _add_verbs(parser: argparse.ArgumentParser, verbs: Mapping[str, Verb]) -> None:
    subparsers = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for name, verb in verbs.items():
        child = subparsers.add_parser(
            name,
            description=help_text(verb),
            help=summary(verb),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_common_options(child, argparse.SUPPRESS, _without(verb))  # also after the verb
        verb.add_arguments(child)


def _without(verb: Verb) -> set[str]:
    """Common options that have no use for a verb, or are refused."""
    unused = set(getattr(verb, "unused_options", ()))
    return unused if getattr(verb, "supports_remote", False) else unused | {"--remote"}


if __name__ == "__main__":
    sys.exit(main())
