"""STREAM_STOPPED: the setpoints of a client after another client has stopped its stream. Pure."""

from math import inf

from twind.robot.finding import Finding, ReasonCode

PAUSE = 0.5  # s without a setpoint after which a stream counts as a new one


class StoppedStream:
    """Memory of the last stream, and of a stop that its client did not ask for.

    A client that streams on has not noticed the stop: the robot would move again at once.
    """

    def __init__(self) -> None:
        self._streams = 0  # client of the last accepted setpoint; 0: none
        self._stopped = 0  # client whose setpoints are refused; 0: none
        self._last = -inf  # s, when it last sent one, or was stopped

    def accept(self, client: int) -> None:
        """Note an accepted setpoint of `client`."""
        self._streams = client

    def stop(self, client: int, streaming: bool, now: float) -> None:
        """Note a stop that `client` requested at `now` (s); `streaming`: a stream moves the robot.

        A client that stops its own stream may begin another one at once.
        """
        if client in (self._streams, self._stopped):
            self._stopped = 0
        elif streaming:
            self._stopped = self._streams
            self._last = now

    def refusal(self, client: int, now: float) -> Finding | None:
        """Return STREAM_STOPPED for a setpoint of `client` at `now` (s); None: it may be judged."""
        if not self._stopped or client != self._stopped:
            return None
        waited = now - self._last
        if waited >= PAUSE:
            self._stopped = 0
            return None
        self._last = now
        message = "another client stopped this stream: send no setpoint for so long (s), then begin anew"
        return Finding(ReasonCode.STREAM_STOPPED, value=waited, bound=PAUSE, message=message)
