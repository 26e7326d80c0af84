"""Count of the calls of one tick of the loop, without those of clock and virtual servos in the process."""

import sys
from collections import Counter
from collections.abc import Callable
from types import FrameType
from typing import Any, NamedTuple

from tests.support.daemon_rig import Rig

WHOLE = 50  # ticks of a count: whole rounds of slow registers (5), overviews (10) and slow rules (5)
OUTSIDE = ("twind_drivers/virtual/", "tests/")


class TickCalls(NamedTuple):
    """Calls of an average tick."""

    python: float
    c: float


class CallCounter:
    """Profile function that counts calls outside of the virtual servos and of the tests."""

    def __init__(self) -> None:
        self.python: Counter[str] = Counter()  # by function
        self.c: Counter[str] = Counter()  # by caller
        self._hidden = 0  # frames of the virtual servos on the stack

    def __call__(self, frame: FrameType, event: str, _argument: Any) -> None:
        code = frame.f_code
        outside = any(part in code.co_filename for part in OUTSIDE)
        if event == "call":
            if outside:
                self._hidden += 1
            elif not self._hidden:
                self.python[f"{code.co_filename}:{code.co_qualname}"] += 1
        elif event == "return":
            self._hidden -= outside
        elif event == "c_call" and not (outside or self._hidden):
            self.c[f"{code.co_filename}:{code.co_qualname}"] += 1


def count_calls(rig: Rig) -> tuple[TickCalls, str]:
    """Return the calls of an average tick, and the functions that are called most, for people."""
    counter = CallCounter()
    for _ in range(WHOLE):
        one_tick(rig, counter)
    most = "\n".join(f"{count / WHOLE:6.1f} {name}" for name, count in counter.python.most_common(40))
    return TickCalls(counter.python.total() / WHOLE, counter.c.total() / WHOLE), most


def one_tick(rig: Rig, profile: Callable[[FrameType, str, Any], None]) -> None:
    """Run one tick of the loop under `profile`."""
    rig.next_tick = max(rig.next_tick, rig.clock.now())
    rig.clock.sleep_until(rig.next_tick)
    until = rig.clock.now() + 1e-9
    sys.setprofile(profile)
    try:
        rig.loop.run(until=until)
    finally:
        sys.setprofile(None)
    rig.next_tick += rig.robot.rate_hz**-1
    rig.collect_news()
