"""`twindctl gap` of a robot that does not move: one line, and no wait where it is stopped."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from twind.command_line.verb import Rejected
from twind.gap.gap_figures import JointGap
from twind.observe import gap

STOPPED = {
    "mode": "live",
    "state": "fault",
    "armed": False,
    "torque_on": False,
    "faults": [{"code": "HW_DISCONNECTED"}],
    "latched": ["HW_DISCONNECTED"],
}


def test_a_stopped_robot_is_refused_at_once_with_its_state_and_the_next_commands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Daemon:
        def call(self, method: str) -> dict[str, Any]:
            return {"GetRobot": {"robot": {"sends_goals": True}}}.get(method, {"status": STOPPED})

    @contextmanager
    def observer(_options: argparse.Namespace) -> Iterator[Daemon]:
        yield Daemon()

    monkeypatch.setattr(gap, "observer", observer)
    monkeypatch.setattr("twind.observe.measuring.measured_motion.require_sent_goals", lambda robot: None)
    options = argparse.Namespace(
        live=True, file=None, seconds=30.0, robot=None, calibration=None, identified=None
    )
    with pytest.raises(
        Rejected, match=r"stopped by HW_DISCONNECTED; torque is off; next: .*`twindctl reset`"
    ):
        gap.run(options)


def test_joints_that_did_not_move_get_one_line_not_a_table() -> None:
    still = [JointGap(name, 10, 0.0, 0.0, None, None, None) for name in ("pan", "tilt")]
    (line,) = gap.table_lines(still, "; the robot is connected, not armed: `twindctl arm`")
    assert line.startswith("no joint moved enough to compare: meanwhile play a motion")
    assert line.endswith("rad; the robot is connected, not armed: `twindctl arm`")
