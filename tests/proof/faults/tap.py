"""The watch on the virtual buses: every byte the daemon sends and gets, to the independent monitor."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from tests.proof.busmon.bus import AnyLimits, limits_of, monitor_of
from tests.proof.busmon.watched import Watched
from tests.support.daemon_rig import Rig
from twind.virtual.virtual_robot_spec import save


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="twind-faults-")


@cache
def _limits(robot: Path, name: str, bus: str, rate_hz: float) -> AnyLimits:
    return limits_of(robot, Path(_folder().name) / f"{name}.yaml", bus, rate_hz=rate_hz)


def _kept(rig: Rig) -> None:
    """The calibration of these servos, as a file: zeros are the same at every start."""
    path = Path(_folder().name) / f"{rig.robot.name}.yaml"
    if not path.exists():
        save(rig.made, path)


UNMONITORED = {"dynamixel2_unwatched"}  # families whose registers no monitor knows


class Tap(Watched):
    """`sent_at`: when each bus was last written to, s. `unmonitored`: buses that nothing judges."""

    def __init__(self, rig: Rig, *, writes: bool = True) -> None:
        _kept(rig)
        self.rig = rig
        self.monitors = {
            name: monitor_of(_limits(rig.robot.path, rig.robot.name, name, rig.robot.rate_hz), writes=writes)
            for name, bus in rig.virtual.items()
            if bus.kind not in UNMONITORED
        }
        self.unmonitored = sorted(rig.virtual.keys() - self.monitors.keys())
        self.sent_at = dict.fromkeys(rig.virtual, -1.0)
        self._said: dict[str, Any] = {}
        for name, bus in rig.virtual.items():
            if name in self.monitors:
                self._tap(self.monitors[name], bus)
            self._clock(name, bus)

    def _clock(self, name: str, bus: Any) -> None:
        receive = bus.receive

        def received(data: bytes, now: float) -> None:
            if data:
                self.sent_at[name] = now
            receive(data, now)

        bus.receive = received

    @property
    def wrong(self) -> list[str]:
        """Violations of the rules of the wire."""
        return [f"{name}: {each}" for name, one in self.monitors.items() for each in one.violations]
