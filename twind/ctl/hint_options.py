"""Text of a `twindctl` command with the options of the present call: a copy reaches the same robot."""

import argparse
import re
import shlex
from dataclasses import dataclass

NAMED = re.compile(r"(?<![\w/.-])twindctl (?P<verb>[a-z]+)\b(?! --port)")  # with --port a scan asks no daemon
START = re.compile(r"^twind$", re.MULTILINE)
QUOTED = re.compile(r"`[^`]*`")
WITH_FILES = ("doctor", "adopt")  # verbs that take --config, --robot, --port and --calibration
ALONE = ("check",)  # verbs that ask no daemon


@dataclass(frozen=True, slots=True)
class HintOptions:
    """Options that select the daemon and the robot of this call, in shell syntax."""

    socket: str = ""  # "--socket DIR "; "": the usual one
    files: str = ""  # " --config FILE --port PORT …"; "": none was named

    def command(self, text: str) -> str:
        """Add the options to every `twindctl VERB`, and to `twind` alone, in one or several command lines."""
        return START.sub(self._start, NAMED.sub(self._complete, text))

    def prose(self, text: str) -> str:
        """Add the options to the commands in backquotes of a text; all other text is unchanged."""
        return QUOTED.sub(lambda quoted: self.command(quoted[0]), text)

    def _start(self, found: re.Match[str]) -> str:
        return f"{found[0]} {self.socket}".rstrip() + self.files

    def _complete(self, found: re.Match[str]) -> str:
        verb = found["verb"]
        if verb in ALONE:
            return found[0]
        return f"twindctl {self.socket}{verb}{self.files if verb in WITH_FILES else ''}"


def command_hint(options: argparse.Namespace, place: str | None = None) -> HintOptions:
    """Build the hint from the options of this call.

    `place`: folder of the daemon's sockets, if another option gives it.
    """
    where = options.socket or place
    files = [
        f" --{name} {shlex.quote(value)}"
        for name in ("config", "robot", "calibration")
        if (value := getattr(options, name, None))
    ]
    ports = [f" --port {shlex.quote(port)}" for port in getattr(options, "port", None) or ()]
    return HintOptions(f"--socket {shlex.quote(where)} " if where else "", "".join([*files, *ports]))
