"""Verbs `reload` and `parameters`: what the daemon goes by. Standard library only."""

import argparse
from collections.abc import Mapping
from typing import Any

from twind.command_line.verb import (
    DONE,
    FunctionVerb,
    UsageError,
    no_arguments,
    observer,
    one_call,
    operator,
    show,
)
from twind.ctl.instance_paths import restart


def _reload_text(options: argparse.Namespace, answer: Mapping[str, Any]) -> str:
    lines = [f"in force: {key}" for key in answer["applied"]]
    lines += [f"needs a restart: {key}" for key in answer["needs_restart"]]
    if answer["needs_restart"]:
        lines.append(f"restart the daemon, disarmed: `{restart(options.socket)}` where it is the service")
    return "\n".join(lines or ["nothing has changed"])


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
    "set up",
    "Reload the files of the daemon and apply the permitted changes.",
    no_arguments,
    one_call("Reload", _reload_text),
)
PARAMETERS = FunctionVerb(
    "set up",
    "Show the parameters in force; KEY=VALUE sets one until the daemon ends.",
    _parameters_arguments,
    _parameters,
    supports_remote=True,
)
