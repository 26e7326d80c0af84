"""Dead-man rule of the page: whether a button is held now. Pure: knows no browser, no socket, no daemon.

A heartbeat that waited in a buffer must not move a robot. So the viewer issues tokens, and a heartbeat is the
return of a token: its age is that of the token, by one clock. A hold ends for good when no token younger than
`HOLD` (s) was returned; it takes a new press to move again.
"""

import threading
from dataclasses import dataclass, field
from enum import Enum

from twind.robot_client.jog_motion import HOLD

BEAT = 0.04  # s between two tokens


class HoldPhase(Enum):
    """Phase of one press."""

    PRESSED = "pressed"  # the page has not returned a token yet: nothing may move
    HELD = "held"
    ENDED = "ended"


@dataclass(frozen=True, slots=True)
class Press:
    """One press of a button. `number` grows with each press of a `tab`."""

    tab: int
    number: int


@dataclass(slots=True)
class _Hold:
    press: Press
    until: float  # s, after which it has lapsed
    issued: dict[int, float] = field(default_factory=dict)  # s, by token: those younger than `HOLD`
    is_returned: bool = False  # a token came back


class DeadManHold:
    """At most one press of one tab at a time. `now`: s, monotonic. Threads may share it."""

    def __init__(self, lasts: float = HOLD) -> None:
        self._lasts = lasts
        self._lock = threading.Lock()
        self._hold: _Hold | None = None
        self._last: dict[int, int] = {}  # the newest number seen, by tab
        self._token = 0
        self._seen = 0.0  # s, the time of the last question

    def press(self, press: Press, now: float) -> bool:
        """Begin a hold, which moves nothing before a token is returned.

        False: a press is under way, or one with this number or a newer one of this tab was seen before.
        """
        with self._lock:
            if press.number <= self._last.get(press.tab, 0):
                return False
            self._last[press.tab] = press.number
            if self._alive(now) is not None:
                return False
            self._hold = _Hold(press, now + self._lasts)
            return True

    def issue(self, press: Press, now: float) -> int | None:
        """Return a new token for the page; None: this press has ended."""
        with self._lock:
            hold = self._alive(now)
            if hold is None or hold.press != press:
                return None
            hold.issued = {token: at for token, at in hold.issued.items() if now - at <= self._lasts}
            self._token += 1
            hold.issued[self._token] = now
            return self._token

    def beat(self, press: Press, token: int, now: float) -> bool:
        """Take a returned token; False: not of this press, returned before, or its press has ended."""
        with self._lock:
            hold = self._alive(now)
            if hold is None or hold.press != press:
                return False
            at = hold.issued.pop(token, None)
            if at is None:
                return False
            hold.until = max(hold.until, at + self._lasts)
            hold.is_returned = True
            return True

    def release(self, press: Press) -> None:
        """End the hold of this tab, also one of another number; a press that comes later with this number or
        an older one is refused."""
        with self._lock:
            self._last[press.tab] = max(press.number, self._last.get(press.tab, 0))
            self._end(press.tab)

    def end(self, press: Press) -> None:
        """End this press alone: what it asked for was refused, or is done."""
        with self._lock:
            if self._hold is not None and self._hold.press == press:
                self._hold = None

    def end_all(self) -> None:
        """End the hold of whatever tab: a stop was asked for."""
        with self._lock:
            self._hold = None

    def forget(self, tab: int) -> None:
        """End the hold of a tab that is gone. Its number is not used again."""
        with self._lock:
            self._end(tab)
            self._last.pop(tab, None)

    def phase(self, press: Press, now: float) -> HoldPhase:
        """Phase of this press at `now`. `ENDED` is final."""
        with self._lock:
            hold = self._alive(now)
            if hold is None or hold.press != press:
                return HoldPhase.ENDED
            return HoldPhase.HELD if hold.is_returned else HoldPhase.PRESSED

    def _end(self, tab: int) -> None:
        if self._hold is not None and self._hold.press.tab == tab:
            self._hold = None

    def _alive(self, now: float) -> _Hold | None:
        """The hold, unless it has lapsed; a time that is unknown or went back ends it."""
        if not self._seen <= now:
            self._hold = None
        self._seen = max(self._seen, now)
        if self._hold is not None and not now <= self._hold.until:
            self._hold = None
        return self._hold
