"""A daemon's end of a line, written by hand: motions that are accepted, and what a test has it say.

What a real daemon makes of the same calls is in the live tests.
"""

import json
from collections.abc import Callable
from typing import Any

from twind.client import Client, NoDaemon

Answer = dict[str, Any]


class ScriptedDaemon:
    """Answers calls; `calls` is what came. `refuse`: an error by method, `absent`: nobody listens."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Answer]] = []
        self.refuse: dict[str, tuple[str, Answer]] = {}
        self.absent = self.dead = False
        self.meanwhile: Callable[[str], None] = lambda method: None  # done while a call is answered
        self.lines: list[ScriptedLine] = []
        self._motions = 0

    def client(self) -> Client:
        """A connection."""
        return Client(line=ScriptedLine(self))

    @property
    def open(self) -> int:
        """Connections that are open."""
        return sum(line.is_open for line in self.lines)

    def named(self, method: str) -> list[Answer]:
        """Parameters of each call of it."""
        return [parameters for name, parameters in self.calls if name == method]

    def answer(self, message: bytes) -> bytes:
        call = json.loads(message)
        method = call["method"].rpartition(".")[2]
        given = call["parameters"]
        self.calls.append((method, given))
        self.meanwhile(method)
        if method in self.refuse:
            name, parameters = self.refuse[method]
            return json.dumps({"error": f"io.twind.Control.{name}", "parameters": parameters}).encode()
        answers: dict[str, Callable[[], Answer]] = {
            "SubmitTrajectory": self._submitted,
            "SetMode": lambda: {"mode": given["mode"]},
            "EStop": lambda: {"state": "estop", "done": True},
            "Cancel": lambda: {"state": "armed"},
        }
        return json.dumps({"parameters": answers.get(method, dict)()}).encode()

    def _submitted(self) -> Answer:
        self._motions += 1
        return {"id": f"m{self._motions}", "phase": "accepted", "progress": 0.0, "verdict": None}


class ScriptedLine:
    """A `Line` to it."""

    where = "told"

    def __init__(self, daemon: ScriptedDaemon) -> None:
        self._daemon = daemon
        self.is_open = False
        self._answers = list[bytes]()
        daemon.lines.append(self)

    def open(self, patience: float) -> None:
        del patience
        if self._daemon.absent:
            raise NoDaemon("nobody listens", absent=True)
        self.is_open = True

    def close(self) -> None:
        self.is_open = False
        self._answers.clear()

    def cut(self) -> None:
        self._daemon.dead = True

    def send(self, message: bytes, patience: float) -> None:
        del patience
        if not self._daemon.dead:
            self._answers.append(self._daemon.answer(message))

    def receive(self, patience: float) -> bytes:
        del patience
        if self._daemon.dead:
            raise EOFError
        return self._answers.pop(0)

    def waiting(self) -> list[bytes]:
        return []


def ended(name: str, phase: str, *findings: Answer, time: float = 0.0) -> Answer:
    """An answer of `Monitor`: how a motion ended, and when: s, monotonic."""
    event = {"code": "MOTION", "message": "x", "findings": list(findings), "id": name or None, "phase": phase}
    return {"topic": "events", "time": time, "event": event}


def ended_in_words(name: str, phase: str, *, time: float = 0.0) -> Answer:
    """The same as a daemon of an older version reports it: in its text alone."""
    event = {"code": "MOTION", "message": f"{name} {phase}", "findings": []}
    return {"topic": "events", "time": time, "event": event}


def moving(motion: str, mode: str = "sim", time: float = 0.0) -> Answer:
    """An answer of `Monitor`: whether anything moves."""
    return {"topic": "status", "time": time, "status": {"motion": motion, "mode": mode}}
