"""Verbs `reload` and `parameters`: what the daemon goes by. Standard library only."""

import argparse
from typing import Any

from twind.command_line.verb import DONE, FunctionVerb, UsageError, observer, operator, show

NONE = "nothing has changed"


def _arguments(_parser: argparse.ArgumentParser) -> None:
    """No options of its own."""


def _reload(options: argparse.Namespace) -> int:
    with operator(options) as client:
        answer = client.call("Reload")
    applied = answer["applied"]
    waiting = answer["needs_restart"]
    lines = [f"in force: {key}" for key in applied] or ([] if waiting else [NONE])
    lines += [f"needs a restart: {key}" for key in waiting]
    show(options, answer, "\n".join(lines))
    return DONE


def _parameters_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "settings",
        nargs="*",
        metavar="KEY=VALUE",
        help="log_level, or latency_warn_ms, latency_block_ms no larger than now; until a reload or restart",
    )


def _parameters(options: argparse.Namespace) -> int:
    given = dict(_setting(word) for word in options.settings)
    if given:
        with operator(options) as client:
            found = client.call("SetParameters", parameters=given)["parameters"]
    else:
        with observer(options) as client:
            found = client.call("GetParameters")["parameters"]
    origins = found.get("origins", {})
    rows = [(key, value) for key, value in found.items() if key not in ("origins", "source")]
    lines = [
        f"{key:<16} {'-' if value is None else value!s:<12} {origins.get(key, 'default')}"
        for key, value in rows
    ]
    show(options, found, "\n".join(lines))
    return DONE


def _setting(word: str) -> tuple[str, Any]:
    key, equals, text = word.partition("=")
    if not equals:
        raise UsageError(f"{word}: expected KEY=VALUE")
    try:
        return key, float(text)
    except ValueError:
        return key, text


RELOAD = FunctionVerb(
    "set up", "Reload the files of the daemon and apply the permitted changes.", _arguments, _reload
)
PARAMETERS = FunctionVerb(
    "set up",
    "Show the parameters in force; KEY=VALUE sets one until the daemon ends.",
    _parameters_arguments,
    _parameters,
    supports_remote=True,
)
