"""Helpers shared by the computed and the real-time tests of view fleet."""

from tests.support.viewer_messages import h24, state, status
from twind.observe.viewing.viewer_state import News, RobotAnnounced, ViewerState
from twind_drivers.clock import FakeClock


def known(*news: News, clock: FakeClock | None = None) -> ViewerState:
    """Viewer state after the announcement of h24 and these messages."""
    made = ViewerState() if clock is None else ViewerState(clock.now)
    for each in (RobotAnnounced(h24()), *news):
        made.take(each)
    return made


def without_loop() -> ViewerState:
    """A robot of another version."""
    told_so = status(state="estop")
    del told_so["status"]["loop"]
    return known(told_so, state(h24()), clock=FakeClock())
