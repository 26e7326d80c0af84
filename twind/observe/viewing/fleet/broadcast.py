"""One action on many robots at once: each has its own errand, so none waits for another's answer."""

import threading
from collections.abc import Callable, Mapping
from functools import partial

from twind.observe.viewing.stop_threads import StopAction, StopOutcome, Tell


class Broadcast:
    """Action on many robots. `errands` returns the errands of the robots known at the time of a request, by
    name."""

    def __init__(self, name: str, errands: Callable[[], Mapping[str, StopAction]]) -> None:
        self._name = name
        self._errands = errands

    def ask(self, tell: Tell) -> None:
        """Start all errands. Each failure is reported at once; the count of successes follows after the last
        answer."""
        errands = self._errands()
        if not errands:
            tell(StopOutcome(False, f"{self._name}: nobody was asked", "no robot was found yet"))
        count = _ReplyCount(self._name, frozenset(errands), tell)
        for name, errand in errands.items():
            errand.ask(partial(count.answered, name))


class _ReplyCount:
    """Count of the robots that have answered one button press."""

    def __init__(self, name: str, asked: frozenset[str], tell: Tell) -> None:
        self._name = name
        self._asked = asked
        self._tell = tell
        self._lock = threading.Lock()
        self._open = set(asked)
        self._failed = set[str]()

    def answered(self, robot: str, outcome: StopOutcome) -> None:
        """Process the outcome of one robot; runs in the thread of that robot's errand."""
        with self._lock:
            self._open.discard(robot)
            if not outcome.done:
                self._failed.add(robot)
            last = not self._open
        if not outcome.done:
            self._tell(StopOutcome(False, f"{robot}: {outcome.title}", outcome.text))
        if last:
            self._tell(self._sum())

    def _sum(self) -> StopOutcome:
        done = len(self._asked) - len(self._failed)
        title = f"{self._name}: {done} of {len(self._asked)} robots"
        if self._failed:
            return StopOutcome(False, title, f"not {', '.join(sorted(self._failed))}")
        return StopOutcome(True, title, "all have answered")
