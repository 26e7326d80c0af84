"""What a flight recorder heard on the link, as `Monitor` would have told it: one form for all who look on."""

import json
from collections.abc import Iterator
from typing import Any

import msgspec

from twind.flight import Entry, Flight, Kind
from twind.front.world import World
from twind.link import Event, Moment, Outward, Overview, Tick, decode_news

STATUS_PERIOD = 0.5  # s, as the topic has it


def news(flight: Flight) -> Iterator[Outward]:
    """The loop's messages, in their order; what this version does not understand is left out."""
    for entry in flight.contents.entries:
        if entry.kind == Kind.NEWS:
            try:
                yield decode_news(entry.data)
            except msgspec.DecodeError:
                continue


def wire(flight: Flight) -> Iterator[Entry]:
    """The bytes that went over the buses, and what happened to their ports."""
    return (each for each in flight.contents.entries if each.kind in (Kind.OUT, Kind.IN, Kind.PORT))


def answers(flight: Flight) -> Iterator[dict[str, Any]]:
    """Answers of `Monitor` to topics state (every tick), status, latency, events, verdicts and trajectories.

    `time` in s, monotonic. State begins with the first overview: before it nobody knows what is slow.
    """
    world, status_due = World(flight.briefing), float("-inf")
    for each in news(flight):
        if isinstance(each, Tick | Overview):
            world.take(each)
        if isinstance(each, Tick) and world.known:
            yield _answer("state", each.time, each.sequence, b'"joints":' + world.state())
            if each.time >= status_due:
                status_due = each.time + STATUS_PERIOD
                yield _answer("status", each.time, each.sequence, b'"status":' + world.status())
        elif isinstance(each, Overview):
            yield _answer("latency", each.time, 0, b'"latency":' + world.latency())
        elif isinstance(each, Event):
            yield _answer("events", each.time, each.sequence, b'"event":' + world.event(each))
        elif isinstance(each, Moment):
            yield from _moment(world, each)


def _moment(world: World, moment: Moment) -> Iterator[dict[str, Any]]:
    verdict = b'"id":' + json.dumps(moment.id).encode() + b',"verdict":' + world.verdict(moment)
    yield _answer("verdicts", moment.time, moment.sequence, verdict)


def _answer(topic: str, time: float, sequence: int, body: bytes) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(b"{" + body + b"}")
    return {"topic": topic, "time": time, "sequence": sequence, "dropped": 0} | found
