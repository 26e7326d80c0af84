"""Errors between a client and the daemon.

ClientError
├── NoDaemon        no process listens on the socket, or this user may not connect
├── Disconnected    the daemon closed the connection
├── NoAnswer        no answer in time; also a TimeoutError
├── NotCarried      the connection does not carry such a call: a remote robot is not armed
├── MotionFailed    a motion began and did not reach its end
└── CallError       the daemon answered with an error
    └── Refused     the gate or the daemon refused; `findings` has the reasons
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from twind.exceptions import TwindError
from twind.protocol.messages import FindingMessage

SHOWN = 3  # findings of one code that get a line each


class ClientError(TwindError):
    """A call did not succeed."""


class NoDaemon(ClientError):
    """No daemon can be reached. The text lists the sockets tried and the start command.

    `absent`: there is none, as far as a socket shows: no such socket, or no process listens on it. Else it is
    unknown: this user may not connect, or (`full`) too many connections wait. `where`: the socket tried.
    """

    def __init__(self, message: str, *, absent: bool = False, full: bool = False, where: str = "") -> None:
        super().__init__(message)
        self.where = where
        self.absent = absent
        self.full = full


class Disconnected(ClientError):
    """The daemon closed the connection, or ended."""


class NoAnswer(ClientError, TimeoutError):
    """The daemon did not answer in time. The connection is closed."""


class NotCarried(ClientError):
    """Call that the connection to this daemon does not carry. The text names it, and the alternative."""


class CallError(ClientError):
    """An answer that is an error. `error`: its qualified name; `parameters`: its fields."""

    def __init__(self, error: str, parameters: Mapping[str, Any]) -> None:
        super().__init__(_text(error, parameters))
        self.error = error
        self.parameters = parameters

    @property
    def name(self) -> str:
        """The error's name without its interface: `LeaseHeld`."""
        return self.error.rpartition(".")[2]


class Refused(CallError):
    """The gate or the daemon refused. Each finding has code, joint, point, time, value, bound, message."""

    @property
    def findings(self) -> Sequence[FindingMessage]:
        """All reasons of the refusal."""
        findings: Sequence[FindingMessage] = self.parameters.get("findings") or ()
        return findings


class MotionFailed(ClientError):
    """A motion began and did not reach its end. `phase`: cancelled, replaced or aborted."""

    def __init__(self, phase: str, findings: Sequence[FindingMessage]) -> None:
        reasons = "; ".join(line.strip() for line in finding_lines(findings, ""))
        super().__init__(f"the motion was {phase}" + (f": {reasons}" if reasons else ""))
        self.phase = phase
        self.findings = findings


def as_error(error: str, parameters: Mapping[str, Any]) -> CallError:
    """Make the exception for an error reply."""
    kind = Refused if error == "io.twind.Control.Refused" else CallError
    return kind(error, parameters)


def _text(error: str, parameters: Mapping[str, Any]) -> str:
    """Format the reasons, one line each."""
    name = error.rpartition(".")[2]
    if name == "Refused":
        return "\n".join(line.strip() for line in finding_lines(parameters.get("findings") or (), "")) or name
    sentence = _SENTENCES.get(name)
    if sentence is not None:
        try:
            return sentence(parameters)
        except (
            KeyError,
            TypeError,
            AttributeError,
        ):  # a newer daemon has other fields: show all
            pass
    fields = ", ".join(f"{key}={value!r}" for key, value in parameters.items())
    return f"{name}: {fields}" if fields else name


def finding_text(finding: FindingMessage) -> str:
    """Format `POS_LIMIT: l_knee, point 3: position 2.9 rad, bound 2.5 rad`."""
    return f"{finding.get('code')}: {finding.get('message')}"


def finding_lines(findings: Sequence[FindingMessage], mark: str) -> list[str]:
    """Format `refused POS_LIMIT: l_knee, point 0: position 3 rad, bound 2.4 rad`, one line per code."""
    codes: dict[str, list[FindingMessage]] = {}
    for finding in findings:
        codes.setdefault(str(finding.get("code")), []).append(finding)
    lines = []
    for same in codes.values():
        shown = same if len(same) <= SHOWN else same[:1]
        others = {finding.get("joint") for finding in same} - {None, same[0].get("joint")}
        rest = f" (and {len(others)} more joints)" if len(same) > SHOWN and others else ""
        lines += [f"{mark:<8} {finding_text(finding)}{rest}" for finding in shown]
    return lines


def _not_found(p: Mapping[str, Any]) -> str:
    known = ", ".join(map(str, p["known"]))
    if known and not p["name"]:
        return f"name a {p['what']}: {known}"
    return f"no {p['what']} {p['name']!r}" + (f"; known: {known}" if known else "")


def _wrong_state(p: Mapping[str, Any]) -> str:
    return f"not in this state: {p['state']}; needs: {', '.join(p['allowed'])}"


def _lease_held(p: Mapping[str, Any]) -> str:
    lease = p["lease"]
    held = f"the lease is held by {lease['holder']}, unless it is not renewed for {lease['expires_in']:.2f} s"
    if "now" in p and lease["uid"] >= 0:  # by an uplink: the holder is a client of the robot's machine
        return f"{held}; it is beside the robot, and no remote client can take it: let its holder release it"
    return f"{held}; --take takes it over (in Python take=True)"


_SENTENCES: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "NotFound": _not_found,
    "WrongState": _wrong_state,
    "LeaseHeld": _lease_held,
    "NotAllowed": lambda p: (
        f"{p['method']} is not for the role {p['role']}: use control.sock (group twind-operator)"
    ),
    "Busy": lambda p: f"busy: {p['what']}",
    "BusFailed": lambda p: f"bus {p['bus']}: {p['message']}" if p["bus"] else str(p["message"]),
    "NotWritten": lambda p: f"{p['path']}: not written: {p['message']}" if p["path"] else str(p["message"]),
    "InvalidParameter": lambda p: f"parameter {p['parameter']}: {p.get('message', 'not allowed')}",
    "MethodNotFound": lambda p: f"the daemon has no method {p['method']}",
    "MethodNotImplemented": lambda p: f"the daemon does not serve {p['method']} yet",
}
