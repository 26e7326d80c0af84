"""The part of a monitor that serial buses share: bytes of the talker cut into packets, violations kept."""

from collections import deque
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from tests.proof.busmon.limits import Limits
from tests.proof.busmon.packet import Malformed
from tests.proof.busmon.stopping import Stopping
from tests.proof.busmon.turns import Turning
from tests.proof.busmon.violation import KEPT, MOST, UNFINISHED, Seen, Violation
from tests.proof.busmon.words import Words


class SerialMonitor:
    """One serial bus; a protocol adds what its packets mean."""

    SIZE_OF: ClassVar[Callable[[bytes, int], int]]  # of the packet that begins there; 0: it is not whole

    def __init__(self, limits: Limits, *, writes: bool = True, hearsay: float = 0.0) -> None:
        """`writes` False: a mirror or a simulation, which writes nothing (W10)."""
        self.limits = limits
        self.servos = Turning(limits)
        self.violations: list[Violation] = []
        self.last: deque[Seen] = deque(maxlen=KEPT)
        self.sent_packets = self.answers = self.goal_packets = 0
        self.words = Words(self._broken, writes=writes, hearsay=hearsay)
        self.stopping = Stopping(self._broken, limits, self.servos)
        self.packet_at = -np.inf  # s, the last instruction packet
        self._since = -np.inf
        self._rest = b""
        self._rest_since = -np.inf

    def _broken(self, rule: str, time: float, id: int | None, text: str) -> None:
        if len(self.violations) < MOST:
            self.violations.append(Violation(rule, time, id, text))

    def sent(self, data: bytes, now: float, since: float | None = None) -> None:
        """Bytes to the servos; they left at `now`, or from `since` on: who stamps may be late."""
        self._since = now if since is None else since
        self.look(now)
        if self.words.stopped:  # it runs again: its silence is over, and counts
            self.words.stopped = False
            self.look(now)
        data = self._rest + data if self._rest else data
        at = 0
        while at < len(data):
            try:
                size = type(self).SIZE_OF(data, at)
                if not size:
                    break
                self._packet(data[at : at + size], now)
            except Malformed as wrong:
                size = max(1, wrong.skip)
                self.last.append(Seen(now, ">", data[at : at + size]))
                self._broken("W8", now, None, f"{wrong}: {data[at : at + size][:64].hex(' ')}")
            at += size
        if at or not self._rest:  # what is not whole yet began now
            self._rest_since = now
        self._rest = data[at:]

    def look(self, now: float) -> None:
        """Time has passed: rules about silence."""
        if self._rest and now - self._rest_since > UNFINISHED:
            self._broken("W8", now, None, f"a packet that does not end: {self._rest[:64].hex(' ')}")
            self._rest = b""
        self.words.look(now)
        self.stopping.look(now)

    def _packet(self, packet: bytes, now: float) -> None:
        """Judge one whole packet. Raises Malformed."""
        raise NotImplementedError
