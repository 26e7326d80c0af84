"""Options that every verb takes, before and after its name. Standard library only."""

import argparse
import os
from collections.abc import Collection
from typing import Any

from twind.protocol.socket_paths import SYSTEM


def add_common_options(
    parser: argparse.ArgumentParser, default: Any, without: Collection[str] = frozenset()
) -> None:
    """Add the options of every verb. `default`: SUPPRESS below another parser that has them.

    The help does not list those of `without`, which have no use for a verb.
    """

    def text(option: str, shown: str) -> str:
        return argparse.SUPPRESS if option in without else shown

    parser.add_argument(
        "--socket", metavar="DIR", default=default, help=text("--socket", "folder of the daemon's sockets")
    )
    parser.add_argument(
        "-i",
        dest="socket",
        metavar="NAME",
        type=lambda name: os.path.join(SYSTEM, name),
        default=default,
        help=text("--socket", f"the daemon of twind@NAME: --socket {SYSTEM}/NAME"),
    )
    remote = "a remote robot, by its uplink: its name, or NAME@tcp/HOST:PORT; `twindctl fleet` lists them"
    parser.add_argument("--remote", metavar="ROBOT", default=default, help=text("--remote", remote))
    json_default = False if default is None else default
    parser.add_argument(
        "--json",
        action="store_true",
        default=json_default,
        help=text("--json", "print JSON, one line each"),
    )
