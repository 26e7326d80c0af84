"""The process of the gap starts where its figures mean something, and nowhere else."""

from types import SimpleNamespace
from typing import Any

import pytest

from twind.exceptions import InvalidInput
from twind.front.gap_monitor import SETTLED, GapMonitor
from twind.observe.measuring.measured_motion import require_sent_goals


class CountedStarts:
    """A front process whose executor only counts."""

    def __init__(self, parameters: dict[str, Any], description: dict[str, Any]) -> None:
        self.starts = 0
        briefing = SimpleNamespace(
            parameters=parameters, description=description, binding=b"x", rate_hz=100.0
        )
        self.world = SimpleNamespace(briefing=briefing, gap=None)
        self.loop = self

    def now(self) -> float:
        return 100.0

    def run_in_executor(self, *_: object) -> Any:
        self.starts += 1
        return SimpleNamespace(add_done_callback=lambda _: None)


@pytest.mark.parametrize(
    ("mode", "armed", "parameters", "compensated", "starts"),
    [
        ("live", True, {}, False, 1),
        ("sim", True, {}, False, 0),
        ("live", False, {}, False, 0),
        ("live", True, {"gap": False}, False, 0),
        ("live", True, {}, True, 0),
    ],
)
def test_it_starts_for_goals_that_reached_a_robot_as_they_are(
    mode: str, armed: bool, parameters: dict[str, Any], compensated: bool, starts: int
) -> None:
    front = CountedStarts(parameters, {"compensate_gravity": compensated})
    monitor = GapMonitor(front)  # type: ignore[arg-type]
    for time in (0.0, SETTLED + 0.1):
        monitor.tick(SimpleNamespace(mode=mode, armed=armed, time=time))  # type: ignore[arg-type]
    assert front.starts == starts


def test_a_recording_with_goals_that_were_not_sent_so_is_refused() -> None:
    with pytest.raises(InvalidInput, match="compensate_gravity"):
        require_sent_goals({"compensate_gravity": True})
    require_sent_goals({"compensate_gravity": False})
    require_sent_goals(None)
