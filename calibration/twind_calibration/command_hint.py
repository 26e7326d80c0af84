"""How a `twindctl` command is printed: with the options of this call: a copy reaches the same robot."""

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
class CommandHint:
    """The options that say which daemon and which robot this call is about, as a shell takes them."""

    socket: str = ""  # "--socket DIR "; "": the usual one
    files: str = ""  # " --config FILE --port PORT …"; "": none was named

    def command(self, text: str) -> str:
        """A command, or several lines of them: every `twindctl VERB`, and `twind` alone, gets its options."""
        return START.sub(self._start, NAMED.sub(self._complete, text))

    def prose(self, text: str) -> str:
        """Words for people: the commands in backquotes get their options, all else stays."""
        return QUOTED.sub(lambda quoted: self.command(quoted[0]), text)

    def _start(self, found: re.Match[str]) -> str:
        return f"{found[0]} {self.socket}".rstrip() + self.files

    def _complete(self, found: re.Match[str]) -> str:
        verb = found["verb"]
        if verb in ALONE:
            return found[0]
        return f"twindctl {self.socket}{verb}{self.files if verb in WITH_FILES else ''}"


def again(options: argparse.Namespace, place: str | None = None) -> CommandHint:
    """Of the options of this call. `place`: where its daemon's sockets are, if another option says so."""
    where = options.socket or place
    files = [
        f" --{name} {shlex.quote(value)}"
        for name in ("config", "robot", "calibration")
        if (value := getattr(options, name, None))
    ]
    ports = [f" --port {shlex.quote(port)}" for port in getattr(options, "port", None) or ()]
    return CommandHint(f"--socket {shlex.quote(where)} " if where else "", "".join([*files, *ports]))
