"""An uncalibrated virtual robot and its daemon, as processes."""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import Daemon, Virtual, robot, until
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main

Words = list[str]
Captured = pytest.CaptureFixture[str]
ROBOT = load_robot("h24")
QUICK = 5.0  # rad/s


class Bench:
    """A specimen of which nothing is known, and a daemon whose state folder is empty at first."""

    def __init__(self, virtual: Virtual, folder: Path) -> None:
        self.virtual = virtual
        self.state = folder / "state"
        self.state.mkdir()
        self.file = self.state / "calibration" / "h24.yaml"
        self.daemon = self.start("mirror")

    def start(self, mode: str) -> Daemon:
        options = ["--mode", mode, "--robot", "h24", "--port", str(self.virtual.folder / "ports" / "main")]
        environment = {"STATE_DIRECTORY": str(self.state)}
        self.daemon = Daemon(self.virtual.folder / "run", *options, environment=environment)
        self.daemon.reach(state="connected")
        return self.daemon

    def restart(self, mode: str) -> None:
        assert self.daemon.end() == 0
        self.start(mode)

    def hands(self, side: str | None, names: Words | None = None) -> None:
        """Take joints to the stops of that side, or to their zeros, and hold them there."""
        beyond = {"lower": -1.0, "upper": 1.0, None: 0.0}[side]
        pose = {
            joint.name: (getattr(joint, side) if side else 0.0) + beyond
            for joint in ROBOT.joints
            if names is None or joint.name in names
        }
        self.virtual.order(fault="hand", pose=pose, speed=QUICK)

    def let_go(self) -> None:
        self.virtual.order(fault="hand", off=True)

    def power_cycle(self) -> None:
        """Every servo wakes up on its one turn."""
        for on in (False, True):
            self.virtual.order(fault="power", on=on)
            time.sleep(0.5)

    def there(self) -> None:
        """Until nobody moves any more."""
        before: list[Any] = []

        def still() -> bool:
            nonlocal before
            time.sleep(0.2)
            now = [servo["position"] for servo in self.virtual.servos()]
            moved = now != before
            before = now
            return not moved

        until(still, 20.0, "the hands are there")

    def verb(self, *words: str) -> int:
        return main(["--socket", str(self.daemon.sockets), "calibrate", *words])


@contextmanager
def benched(*words: str) -> Iterator[Bench]:
    """Beside a virtual robot with these options."""
    with robot("h24", "--muscles", "first-order", *words) as (virtual, folder):
        made = Bench(virtual, folder)
        try:
            yield made
        finally:
            if made.daemon.process.poll() is None:
                made.daemon.process.kill()
            made.daemon.process.wait(10)


def json_lines(output: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in output.splitlines()]
