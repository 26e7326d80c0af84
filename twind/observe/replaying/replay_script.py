"""Commands to the daemon of a recording, the time from which they can be replayed, their results. Pure."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import msgspec
import numpy as np

from twind import link
from twind.exceptions import OperationFailed
from twind.flight import EntryKind, LoadedFlight
from twind.front.joint_naming import JointNames
from twind.link import (
    ApplyChanges,
    ConnectionClosed,
    Outward,
    Overview,
    Reply,
    Submit,
    Tick,
    decode_command,
    decode_news,
)
from twind.observe.recording.flight_monitor_messages import news
from twind.observe.replaying.replay_outcome import CommandOutcome, RunOutcome, UnclearedFaults, answer
from twind.robot.arrays import Floats

LOOKING = 5.0  # s, at most, that a front looks ahead before it passes a trajectory on
STAY = 2.0  # s, at most, that a client stays longer than it did, for answers that it had before it hung up
SIM = "sim"  # the mode without a bus
REST = ("idle", "holding")  # motions
FIT = ("connected", "armed")  # states of a robot that a replay can begin with; in sim also without a bus
VIEW = "`twindctl replay --view FILE` shows it all the same"

Heard = Mapping[int, bool]  # ticket of a call that was answered -> that was all of it


@dataclass(frozen=True, slots=True)
class RecordedCommand:
    """One command, or the end of a client."""

    time: float  # s, of the recording
    command: link.Command | ConnectionClosed
    data: bytes  # arrays of a trajectory

    @property
    def call_time(self) -> float:
        """Time when the call arrived, s; for a trajectory, before it was looked ahead at."""
        received = getattr(self.command, "received", None) or self.time
        return received if self.time - LOOKING <= received <= self.time else self.time

    @property
    def method(self) -> str:
        """Name of the method in the interface."""
        if isinstance(self.command, Submit):
            return "Check" if self.command.check_only else "SubmitTrajectory"
        return str(type(self.command).__struct_config__.tag)


@dataclass(frozen=True)
class ReplayScript:
    """Commands of a recording from `begin` to `end` (s, of the recording), the state at `begin`, and the
    results."""

    names: tuple[str, ...]
    begin: float
    end: float
    mode: str
    armed: bool
    holder: int  # the client that had the lease at the beginning, 0: none
    goal: Floats  # rad (n,), goals at the beginning, NaN: none
    asked: tuple[RecordedCommand, ...]
    recorded: RunOutcome
    left_out: tuple[str, ...]  # what is not asked again, in words
    whole: bool  # nothing of that would have changed anything: checks alone
    heard: Mapping[int, Heard]  # client -> what of its calls was answered when it hung up

    @property
    def commands(self) -> tuple[RecordedCommand, ...]:
        """Recorded commands that get an answer."""
        return tuple(each for each in self.asked if isinstance(each.command, link.Command))

    def stays(self, client: int, events: Heard) -> bool:
        """Check that a client must stay connected: it closed with its answers, and has not all of them again.

        `events`: the answers received by now.
        """
        then = self.heard.get(client, {})
        return any(ticket not in events or events[ticket] < whole for ticket, whole in then.items())


def score(flight: LoadedFlight, last: float = inf) -> ReplayScript:
    """Build the replay script of the `last` seconds of a recording. Raises OperationFailed."""
    names = JointNames([joint.name for joint in flight.briefing.joints])
    heard = _news(flight)
    if not heard:
        raise OperationFailed("the recording holds no states: nothing was recorded yet")
    wire = (each.time for each in flight.contents.entries if each.kind in (EntryKind.OUT, EntryKind.IN))
    end = flight.contents.entries[-1].time
    tick, overview = _beginning(heard, max(end - last, next(wire, -inf)))
    begin = tick.time
    asked, left_out, whole = _recorded_commands(flight, begin)
    commands = [each.command for each in asked if isinstance(each.command, link.Command)]
    known = _received_by_client(flight, commands)
    # answered after their clients had disconnected
    late = {
        each.ticket
        for each in _calls(commands)
        if each.client in known and each.ticket not in known[each.client]
    }
    told = [each for each in heard if not (isinstance(each, Reply) and each.ticket in late)]
    return ReplayScript(
        names=names.joints,
        begin=begin,
        end=end,
        mode=tick.mode,
        armed=tick.armed,
        holder=overview.lease_client,
        goal=np.frombuffer(tick.goal, "<f8").copy(),
        asked=tuple(asked),
        recorded=outcome(names, begin, commands, [each for each in told if _time(each, begin) >= begin]),
        left_out=tuple(left_out),
        whole=whole,
        heard=known,
    )


def outcome(
    names: JointNames, begin: float, commands: Sequence[link.Command], news: Sequence[Outward]
) -> RunOutcome:
    """Build the outcome of the commands from the messages of a loop. `begin`: s, from which faults are
    counted."""
    replies: dict[int, list[Reply]] = {}
    standing = UnclearedFaults()
    tick = None
    overview = None
    for each in news:
        if isinstance(each, Reply):
            replies.setdefault(each.ticket, []).append(each)
        elif isinstance(each, Overview):
            overview = each
        elif isinstance(each, Tick):
            tick = each
            if overview is not None:  # sent right before the tick that has its state
                faults = [(fault.code.value, names.name(fault.joint)) for fault in overview.faults]
                standing.look(overview.time - begin, tick.state, faults)
            overview = None
    answers = tuple(_answer(names, each, replies.get(each.ticket, [])) for each in commands)
    state, mode, armed = ("", "", False) if tick is None else (tick.state, tick.mode, tick.armed)
    return RunOutcome(answers, standing.end(), state, mode, armed)


def _answer(names: JointNames, command: link.Command, replies: list[Reply]) -> CommandOutcome:
    plain = [names.reply(msgspec.to_builtins(reply.parameters)) for reply in replies]
    method = RecordedCommand(0.0, command, b"").method
    return answer(method, plain, replies[-1].error if replies else None)


# ------------------------------------------------------------------------------------------ reading


def _news(flight: LoadedFlight) -> list[Outward]:
    try:
        return list(news(flight, strict=True))
    except msgspec.DecodeError as error:
        raise _foreign(flight, "messages", error) from None


def _time(news: Outward, otherwise: float) -> float:
    """s; answers have none of their own, and belong to commands that do."""
    return float(getattr(news, "time", otherwise))


def _beginning(news: Sequence[Outward], first: float) -> tuple[Tick, Overview]:
    """Find the first moment of a robot at rest, all joints answering, nothing latched, and its messages.

    `first`: s, the earliest moment: the state of the buses before their first bytes is not known. Raises
    OperationFailed.
    """
    overview: Overview | None = None
    why = "its robot is never at rest"
    for each in news:
        if isinstance(each, Overview):
            overview = each
        if not isinstance(each, Tick) or overview is None or each.motion not in REST or each.time < first:
            continue
        if each.mode == SIM:
            fit = each.state == "disconnected"
        else:
            fit = each.state in FIT
        if fit and (not each.armed or (all(each.heard) and not overview.faults)):
            return each, overview
        why = f"at rest its robot is {each.state}" + (", with faults" if overview.faults else "")
    raise OperationFailed(f"there is no moment to begin at: {why}; {VIEW}")


def _recorded_commands(flight: LoadedFlight, begin: float) -> tuple[list[RecordedCommand], list[str], bool]:
    found: list[RecordedCommand] = []
    left_out: list[str] = []
    for entry in flight.contents.entries:
        if entry.time < begin:
            continue
        if entry.kind == EntryKind.COMMAND:
            command = _decoded(flight, entry.data)
            if isinstance(command, ApplyChanges):
                left_out.append("a reload: the daemon has the values of the file from its beginning")
            elif isinstance(command, link.Command | ConnectionClosed):
                found.append(RecordedCommand(entry.time, command, b""))
        elif entry.kind == EntryKind.ARRAYS and found and isinstance(found[-1].command, Submit):
            found[-1] = RecordedCommand(found[-1].time, found[-1].command, entry.data)
    pointed = [each for each in found if not isinstance(each.command, Submit) or each.data]
    pointless = Counter(each.method for each in found if isinstance(each.command, Submit) and not each.data)
    whole = not left_out and pointless.keys() <= {"Check"}
    left_out += [f"{count} of {method}: points were not recorded" for method, count in pointless.items()]
    return pointed, left_out, whole


def _calls(commands: Sequence[link.Command]) -> list[link.Command]:
    """Without those that a front sends of itself for its clients: they share the ticket 0."""
    return [each for each in commands if each.ticket]


def _received_by_client(flight: LoadedFlight, commands: Sequence[link.Command]) -> dict[int, Heard]:
    """Return the answers that each closed client had received by then: link messages are recorded in their
    order."""
    clients = {each.ticket: each.client for each in _calls(commands)}
    answered: dict[int, bool] = {}
    found: dict[int, Heard] = {}
    for entry in flight.contents.entries:
        if entry.kind == EntryKind.NEWS:
            said = decode_news(entry.data)
            if isinstance(said, Reply) and said.ticket in clients:
                answered[said.ticket] = not said.continues
        elif entry.kind == EntryKind.COMMAND:
            gone = decode_command(entry.data)
            if isinstance(gone, ConnectionClosed):
                found[gone.client] = {
                    ticket: whole for ticket, whole in answered.items() if clients[ticket] == gone.client
                }
    return found


def _decoded(flight: LoadedFlight, data: bytes) -> Any:
    try:
        return decode_command(data)
    except msgspec.DecodeError as error:
        raise _foreign(flight, "commands", error) from None


def _foreign(flight: LoadedFlight, what: str, error: Exception) -> OperationFailed:
    version = flight.briefing.version
    return OperationFailed(
        f"this version does not read the {what} of twind {version} ({error}): use that one"
    )
