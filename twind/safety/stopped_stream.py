"""STREAM_STOPPED: the setpoints of a client after another client has stopped its stream. Pure."""

from math import inf

from twind.robot.finding import Finding, ReasonCode

PAUSE = 0.5  # s without a setpoint after which a stream counts as a new one


class StoppedStream:
    """Memory of the last stream, and of stops that its client did not ask for.

    A client that streams on has not noticed the stop: the robot would move again at once.
    """

    def __init__(self) -> None:
        self._streams = 0  # client of the last accepted setpoint
        self._accepted_at = -inf  # s
        self._last: dict[int, float] = {}  # by stopped client: s, when it last sent one, or was stopped

    def accept(self, client: int, now: float) -> None:
        """Note an accepted setpoint of `client` at `now` (s)."""
        self._streams = client
        self._accepted_at = now

    def stop(self, client: int, now: float) -> None:
        """Note a stop that `client` requested at `now` (s).

        It ends a stream whose last setpoint is no older than the pause: a late one would begin it again. A
        client that stops its own stream may begin another one at once.
        """
        self._last = {each: last for each, last in self._last.items() if now - last < PAUSE}
        self._last.pop(client, None)
        if client != self._streams and now - self._accepted_at < PAUSE:
            self._last[self._streams] = now

    def refusal(self, client: int, now: float) -> Finding | None:
        """Return STREAM_STOPPED for a setpoint of `client` at `now` (s); None: it may be judged."""
        waited = now - self._last.get(client, -inf)
        if waited >= PAUSE:
            self._last.pop(client, None)
            return None
        self._last[client] = now
        message = "another client stopped this stream: send no setpoint for so long (s), then begin anew"
        return Finding(ReasonCode.STREAM_STOPPED, value=waited, bound=PAUSE, message=message)
