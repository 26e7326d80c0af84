"""Dead-man rule of a terminal's keys: which are held now. Pure.

Bytes of a terminal may have waited, for instance in a network that was cut. So the terminal is asked for its
status again and again. It answers in order with the keys: what comes after an answer happened after the
question. A key is held only as long as the newest question that was answered is younger than `HOLD`.
"""

from collections import deque

from twind.ctl.teleoperating.terminal_codes import KeyEvent, TerminalKey
from twind.robot_client.jog_motion import HOLD


class HeldKeys:
    """Held keys. `now`: s, monotonic.

    Where the terminal reports releases, a key is held until its release. Elsewhere it is held for `HOLD`
    after each of its events, of which a held key sends one every 30 to 90 ms: a single press is a short step.
    """

    def __init__(self, *, releases: bool) -> None:
        self._releases = releases
        self._questions: deque[float] = deque()  # s, of those that are not answered
        self._proof = -HOLD  # s, of the newest one that was answered
        self._seen: dict[str, float] = {}  # s, the proof at the last event, by key
        self._repeated: set[str] = set()  # keys that came again while they were held

    def ask(self, now: float) -> None:
        """Note that the terminal was asked for its status."""
        self._questions.append(now)

    def answer(self) -> None:
        """Note its answer to the oldest question."""
        if self._questions:
            self._proof = self._questions.popleft()

    @property
    def is_answered(self) -> bool:
        """Every question was answered."""
        return not self._questions

    def take(self, key: TerminalKey) -> None:
        """Take an event. A key that is held begins with its press, not with a repeat."""
        if key.event is KeyEvent.RELEASED:
            self._drop(key.name)
        elif key.name in self._seen:
            if self._proof - self._seen[key.name] <= HOLD:
                self._repeated.add(key.name)
            self._seen[key.name] = self._proof
        elif key.event is KeyEvent.PRESSED:
            self._seen[key.name] = self._proof

    def drop_all(self) -> None:
        """Drop all keys: the window lost the focus, and their releases go to another one."""
        self._seen.clear()
        self._repeated.clear()

    def held(self, now: float) -> tuple[str, ...]:
        """Return the keys that are held; one that has lapsed must be pressed again."""
        for name in list(self._seen):
            if not now - (self._proof if self._releases else self._seen[name]) <= HOLD:
                self._drop(name)
        return tuple(self._seen)

    def is_kept(self, name: str) -> bool:
        """Return True if a key that is held is not only tapped, as far as the terminal tells."""
        return self._releases or name in self._repeated

    def _drop(self, name: str) -> None:
        self._seen.pop(name, None)
        self._repeated.discard(name)
