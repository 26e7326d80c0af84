"""SIGKILL and SIGSTOP of a real daemon whose virtual robot has a supply relay and a stop button.

`python -m tests.support.relay_runs 20` prints how long the relay took to open, in ms.
"""

import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.support.processes import Daemon, Virtual, arm, daemon, until
from twind.config.robot_file import load_robot

POWER = """
power:
  relay: {{kind: lcus1, port: {folder}/ports/relay}}
stop_button: {{kind: serial, port: {folder}/ports/stop_button, level: {level}}}
"""


def robot_file(folder: Path, level: str = "settle") -> Path:
    """A file of `h24` with relay and button on the ports of a virtual robot in `folder`."""
    plain = load_robot("h24")
    text = plain.path.read_text().replace("mjcf: h24.xml", f"mjcf: {plain.mjcf_path}")
    path = folder / "h24-relay.yaml"
    path.write_text(text + POWER.format(folder=folder, level=level))
    return path


@contextmanager
def powered_robot(folder: Path, level: str = "settle") -> Iterator[Virtual]:
    """The virtual robot; nothing holds its relay."""
    virtual = Virtual(folder, str(robot_file(folder, level)))
    try:
        yield virtual
    finally:
        virtual.close()


def power(virtual: Virtual) -> dict[str, Any]:
    """State of relay and button."""
    found: dict[str, Any] = virtual.order(query="state")["power"]
    return found


def wait_closed(virtual: Virtual) -> None:
    """Wait until the relay is closed."""
    until(lambda: power(virtual)["closed"], 20.0, "the relay closes")


def opening_time(virtual: Virtual, running: Daemon, number: int) -> float:
    """Send a signal to the loop of a robot under power; return the time until the relay opened, s."""
    sent = time.monotonic()
    os.kill(running.process.pid, number)
    until(lambda: not power(virtual)["closed"], 2.0, "the relay opens")
    opened: float = power(virtual)["changed_at"]
    return opened - sent


def opening_times(folder: Path, number: int, count: int) -> list[float]:
    """Times until the relay opened (s) after so many signals, each to a daemon that has the robot armed."""
    times = []
    with powered_robot(folder) as virtual:
        for _ in range(count):
            with daemon(virtual, folder) as running:
                running.reach(state="connected", supply_relay="closed", stop_button="released")
                with running.client() as client:
                    arm(client)
                    times.append(opening_time(virtual, running, number))
    return times


def main() -> None:
    """Print the times of both signals."""
    count = int(sys.argv[1])
    for number in (signal.SIGKILL, signal.SIGSTOP):
        with tempfile.TemporaryDirectory(prefix="twind-relay-") as folder:
            found = sorted(1e3 * each for each in opening_times(Path(folder), number, count))
        print(f"{number.name}: {[round(each, 1) for each in found]}, median {found[count // 2]:.1f}")


if __name__ == "__main__":
    main()
