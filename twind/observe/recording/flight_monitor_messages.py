"""Link messages of a flight recorder in the form of `Monitor` answers: one form for all readers."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from twind.flight import EntryKind, FlightEntry, LoadedFlight
from twind.front.accepted_trajectories import AcceptedTrajectory, PendingVerdict
from twind.front.state_cache import StateCache, encode
from twind.link import (
    Event,
    Outward,
    Overview,
    Submit,
    Tick,
    VerdictReport,
    decode_command,
    decode_news,
    unpack_path,
)

# s, as the topics have it
STATUS_PERIOD = 0.5
HISTOGRAMS = 1.0


def news(flight: LoadedFlight, *, strict: bool = False) -> Iterator[Outward]:
    """The loop's messages, in their order; what this version does not understand is left out.

    `strict`: raises msgspec.DecodeError for that instead.
    """
    for entry in flight.contents.entries:
        if entry.kind == EntryKind.NEWS:
            try:
                yield decode_news(entry.data)
            except msgspec.DecodeError:
                if strict:
                    raise


def wire(flight: LoadedFlight) -> Iterator[FlightEntry]:
    """The bytes that went over the buses, and what happened to their ports."""
    return (
        each for each in flight.contents.entries if each.kind in (EntryKind.OUT, EntryKind.IN, EntryKind.PORT)
    )


def answers(flight: LoadedFlight) -> Iterator[dict[str, Any]]:
    """Answers of `Monitor` to topics state (every tick), status, latency, events, verdicts and trajectories.

    `time` in s, monotonic. State begins with the first overview, which has the slow values.
    """
    told = _MonitorMessages(StateCache(flight.briefing))
    entries = flight.contents.entries
    for place, entry in enumerate(entries):
        if entry.kind == EntryKind.COMMAND:
            told.submitted(entry, entries[place + 1 : place + 2])
        elif entry.kind == EntryKind.NEWS:
            yield from told.news(entry)


class _MonitorMessages:
    """Answers that a front would have sent, datagram by datagram."""

    def __init__(self, world: StateCache) -> None:
        self._world = world
        self._judged = PendingVerdict()
        self._status_due = self._histograms_due = float("-inf")

    def news(self, entry: FlightEntry) -> Iterator[dict[str, Any]]:
        """Answers to one datagram of the loop."""
        try:
            each = decode_news(entry.data)
        except msgspec.DecodeError:
            return
        if isinstance(each, Tick | Overview):
            self._world.take(each)
        if isinstance(each, Tick):
            yield from self._tick(each)
        elif isinstance(each, Overview):
            whole = each.time >= self._histograms_due
            self._histograms_due = each.time + HISTOGRAMS if whole else self._histograms_due
            yield _answer("latency", each.time, 0, b'"latency":' + self._world.latency(whole=whole))
        elif isinstance(each, Event):
            yield _answer("events", each.time, each.sequence, b'"event":' + self._world.event(each))
        elif isinstance(each, VerdictReport):
            verdict = b'"verdict":' + self._world.verdict(each)
            yield _answer("verdicts", each.time, each.sequence, verdict) | {"id": each.id}
            followed = self._judged.resolve(each)
            if followed is not None:
                accepted = b'"accepted":' + encode(followed.plain(self._world.names))
                yield _answer("trajectories", each.time, each.sequence, accepted)

    def submitted(self, entry: FlightEntry, after: Sequence[FlightEntry]) -> None:
        """A command; a trajectory's numbers come `after` it."""
        try:
            command = decode_command(entry.data)
            if not isinstance(command, Submit) or command.check_only or not after:
                return
            path = unpack_path(after[0].data, command, len(self._world.briefing.joints))
        except (msgspec.DecodeError, ValueError):
            return
        names = self._world.names.joints
        tolerances = [{"joint": names[j], "path": way, "goal": goal} for j, way, goal in command.tolerances]
        asked = {"start_in": command.start_in, "goal_time": command.goal_time, "tolerances": tolerances}
        self._judged.wait(AcceptedTrajectory(command.id, command.holder, path, asked))

    def _tick(self, tick: Tick) -> Iterator[dict[str, Any]]:
        world = self._world
        if not world.is_known:
            return
        yield _answer("state", tick.time, tick.sequence, b'"joints":' + world.state())
        if tick.time >= self._status_due:
            self._status_due = tick.time + STATUS_PERIOD
            yield _answer("status", tick.time, tick.sequence, b'"status":' + world.status())


def _answer(topic: str, time: float, sequence: int, body: bytes) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(b"{" + body + b"}")
    return {"topic": topic, "time": time, "sequence": sequence, "dropped": 0} | found
