"""Subscribers of Monitor: their topics, their rates and the messages sent to them. Front process.

The body of a message is encoded once per piece of news, for all subscribers.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from twind.front.accepted_trajectories import AcceptedTrajectory
from twind.front.client_calls import ClientCall
from twind.front.message_stream import MessageStream
from twind.front.state_cache import StateCache, encode
from twind.link import Event, Overview, Tick, VerdictReport

# topic -> default rate, Hz
PERIODIC = {"state": 10.0, "latency": 10.0, "status": 2.0, "raw": 10.0}
# topic -> field of its message, where the names differ
KEYS = {"state": "joints", "events": "event", "verdicts": "verdict", "trajectories": "accepted"}
HISTOGRAMS = "histograms"  # of topic latency, due once a second
TOPICS = (*PERIODIC, "events", "verdicts", "trajectories", "stream")


@dataclass(slots=True)
class MonitorSubscriber:
    """One Monitor call. `dropped`: messages lost since the last one that was sent."""

    call: ClientCall
    stream: MessageStream
    topics: frozenset[str]
    period: dict[str, float]  # s, by topic
    due: dict[str, float] = field(default_factory=dict)  # s, by topic
    dropped: int = 0
    status: bytes | None = None  # that it was sent last

    def wants(self, topic: str, now: float, slack: float) -> bool:
        """Return True if a message of a periodic topic is due; `slack` s too early counts as due."""
        if topic not in self.topics:
            return False
        due = self.due.get(topic, now)
        if now + slack < due:
            return False
        self.due[topic] = max(due, now - slack) + self.period[topic]
        return True

    def send(self, body: bytes) -> None:
        """A message that ends with `body`, parameters after `dropped`; the only one without `more`."""
        if self.call.more:
            self.stream.publish(body, self)
        else:
            self.call.reply(b'{"dropped":0,' + body[:-1])


def by_histograms(wanting: list[MonitorSubscriber], now: float) -> dict[bool, list[MonitorSubscriber]]:
    """Split the subscribers of latencies by whether this message includes histograms (True) or not (False).

    Each subscriber gets histograms once a second.
    """
    found: dict[bool, list[MonitorSubscriber]] = {True: [], False: []}
    for watcher in wanting:
        due = watcher.due.get(HISTOGRAMS, now)
        whole = now + 0.05 >= due
        watcher.due[HISTOGRAMS] = now + 1.0 if whole else due
        found[whole].append(watcher)
    return found


class SubscriberRegistry:
    """Subscribers of all connections."""

    def __init__(self, world: StateCache) -> None:
        self._world = world
        self._watchers: list[MonitorSubscriber] = []
        self._slack = 0.5 / world.briefing.rate_hz

    def watch(self, call: ClientCall, stream: MessageStream, topics: list[str], rate: float | None) -> None:
        """Begin a Monitor call. `rate` in Hz for the periodic topics, None: each its own."""
        most = self._world.briefing.rate_hz
        period = {topic: 1.0 / min(rate or usual, most) for topic, usual in PERIODIC.items()}
        self._watchers.append(MonitorSubscriber(call, stream, frozenset(topics), period))

    def forget(self, client: int) -> None:
        """Remove the subscribers of a connection that is gone."""
        self._watchers = [watcher for watcher in self._watchers if watcher.call.caller.number != client]

    def tick(self, tick: Tick) -> None:
        """Send the topics that follow the tick."""
        world = self._world
        number = tick.sequence
        self._status(tick)
        for topic, piece, time in (("state", world.state, tick.time), ("raw", world.raw, tick.read)):
            wanting = [watcher for watcher in self._watchers if watcher.wants(topic, tick.time, self._slack)]
            self._send(wanting, topic, piece, time, number)

    def _status(self, tick: Tick) -> None:
        """Send a changed status to the subscribers that are due; most ticks have none."""
        due = [watcher for watcher in self._watchers if "status" in watcher.topics]
        if not due:
            return
        status = self._world.status()
        other = [watcher for watcher in due if watcher.status is not status]
        wanting = [watcher for watcher in other if watcher.wants("status", tick.time, self._slack)]
        for watcher in wanting:
            watcher.status = status
        self._send(wanting, "status", lambda: status, tick.time, tick.sequence)

    def overview(self, overview: Overview) -> None:
        """Send the topics that follow the overview."""
        wanting = [watcher for watcher in self._watchers if watcher.wants("latency", overview.time, 0.05)]
        for whole, to in by_histograms(wanting, overview.time).items():
            piece = partial(self._world.latency, whole=whole)
            self._send(to, "latency", piece, overview.time, self._sequence)

    def event(self, event: Event) -> None:
        """Send an event to all subscribers of events."""
        self._at_once("events", lambda: self._world.event(event), event.time, event.sequence)

    def verdict(self, moment: VerdictReport) -> None:
        """Send a verdict to all subscribers of verdicts."""
        self._at_once("verdicts", lambda: self._world.verdict(moment), moment.time, moment.sequence)

    def accepted(self, accepted: AcceptedTrajectory, moment: VerdictReport) -> None:
        """Send an accepted path to all subscribers of trajectories."""

        def piece() -> bytes:
            return encode(accepted.plain(self._world.names))

        self._at_once("trajectories", piece, moment.time, moment.sequence)

    def stream(self, streaming: dict[str, object], time: float) -> None:
        """Send a report to all subscribers of streamers."""
        self._at_once("stream", lambda: encode(streaming), time, self._sequence)

    @property
    def _sequence(self) -> int:
        return 0 if self._world.tick is None else self._world.tick.sequence

    def _at_once(self, topic: str, piece: Callable[[], bytes], time: float, sequence: int) -> None:
        wanting = [watcher for watcher in self._watchers if topic in watcher.topics]
        self._send(wanting, topic, piece, time, sequence)

    def _send(
        self,
        to: list[MonitorSubscriber],
        topic: str,
        piece: Callable[[], bytes],
        time: float,
        sequence: int,
    ) -> None:
        if not to:
            return
        head = b'"topic":"%s","time":%.6f,"sequence":%d' % (topic.encode(), time, sequence)
        body = head + b',"%s":%s}}' % (KEYS.get(topic, topic).encode(), piece())
        for watcher in to:
            watcher.send(body)
        # A subscriber that ended meanwhile has changed the list already.
        self._watchers = [watcher for watcher in self._watchers if not watcher.call.finished]
