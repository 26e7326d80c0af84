"""A virtual robot and its daemon in mode live, shared by the tests of one file."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.support.processes import BUSY, Daemon, Virtual, daemon, robot, until
from twind.client import CallError


class LiveRobot:
    """The virtual robot and the daemon of the moment; a test may end the daemon or leave the robot armed.

    expected_faults: codes of faults that the running test may leave; empty again with the next `ready`.
    """

    def __init__(self, virtual: Virtual, folder: Path) -> None:
        self.virtual = virtual
        self.folder = folder
        self.expected_faults: set[str] = set()
        self.start()

    def start(self) -> Daemon:
        """Start a daemon in place of one that has ended. It is not connected yet."""
        self._daemon = daemon(self.virtual, self.folder)
        self.running = self._daemon.__enter__()
        return self.running

    def close(self) -> None:
        """Kill the daemon if it runs."""
        self._daemon.__exit__(None, None, None)

    def unexpected_faults(self) -> list[dict[str, Any]]:
        """Faults that the last test left without expecting them; a machine too busy may add its own (`BUSY`).

        No fault where the daemon has ended. Nothing is expected from now on.
        """
        expected = self.expected_faults | BUSY
        self.expected_faults = set()
        if self.running.process.poll() is not None:
            return []
        return [fault for fault in self.running.reach()["faults"] if fault["code"] not in expected]

    def ready(self) -> None:
        """Wait until the robot is connected, disarmed and without faults; undo what the last test left.

        Raises AssertionError, once that is undone, where the last test left a fault that it did not expect.
        """
        left = self.unexpected_faults()
        for bus in self.virtual.ports:
            self.virtual.order(fault="clear", bus=bus)
        if self.running.process.poll() is not None:
            self.start()
        self.running.reach(hw_connected=True)

        def reset() -> bool:
            with self.running.client() as client, suppress(CallError):
                client.call("AcquireLease", take=True)
                client.call("Disarm")
                if client.call("GetStatus")["status"]["faults"]:
                    client.call("Reset")
                client.call("ReleaseLease")
                return True
            return False

        until(reset, 15.0, self.running.log.read_text)
        self.running.reach(state="connected", armed=False, lease=None)
        assert not left, left

    def places(self) -> list[float]:
        """Positions of all servos, in ticks."""
        return [servo["position"] for servo in self.virtual.servos()]

    def moved(self, before: list[float]) -> float:
        """Largest distance of a servo from `before`, in ticks."""
        return max(abs(now - then) for now, then in zip(self.places(), before, strict=True))

    def torque(self) -> set[bool]:
        """Torque states among the servos."""
        return {bool(servo["torque"]) for servo in self.virtual.servos()}


@contextmanager
def live_robot(name: str = "h24", *options: str) -> Iterator[LiveRobot]:
    """A robot of that name, with options of `twind-virtual`, and its daemon."""
    with robot(name, *options) as (virtual, folder):
        made = LiveRobot(virtual, folder)
        try:
            yield made
            left = made.unexpected_faults()
            assert not left, left
        finally:
            made.close()
