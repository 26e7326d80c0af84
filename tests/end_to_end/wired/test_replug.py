"""An adapter that is pulled out and comes back under another name, in real time: real processes, real ptys.

Bounds are several times what is promised (seen within 50 ms, back within 1 s: docs/safety.md), because a
shared machine stands still at times; the figures themselves are printed.
"""

import os
import pty
import time
from collections.abc import Iterator
from typing import Any

from tests.support.processes import Virtual, arm, daemon, robot
from twind.client import Client

# s
SEEN = 0.5
BACK = 3.0


def until_lost(news: Iterator[dict[str, Any]]) -> float:
    """Seconds until the daemon says that it lost a port. The status is told ten times a second only."""
    begun = time.monotonic()
    while next(news)["event"]["code"] != "PORT_LOST":
        assert time.monotonic() - begun < SEEN
    return time.monotonic() - begun


def until_connected(client: Client, seconds: float) -> float:
    """Seconds until every bus is identified."""
    begun = time.monotonic()
    while not client.call("GetStatus")["status"]["hw_connected"]:
        assert time.monotonic() - begun < seconds
        time.sleep(0.002)
    return time.monotonic() - begun


def places(virtual: Virtual) -> list[float]:
    return [servo["position"] for servo in virtual.servos()]


def test_a_bus_that_comes_back_under_another_name_is_found_by_its_link_and_nothing_moves() -> None:
    with robot("h24-split") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        stable = folder / "ports" / "upper"
        figures = []
        taken: list[int] = []
        with running.client() as client, running.client() as watcher:
            news = watcher.stream("Monitor", topics=["events"])
            arm(client)
            for away in (0.15, 0.4, 1.0):
                name = os.readlink(stable)
                kept = os.open(name, os.O_RDWR | os.O_NOCTTY)  # else any process takes the name
                virtual.order(fault="unplug", bus="upper")
                seen = until_lost(news)
                assert not stable.exists()
                os.close(kept)
                for _ in range(64):  # lower names are given first, and another test may have freed some
                    taken += pty.openpty()
                    if os.ttyname(taken[-1]) == name:
                        break
                assert os.ttyname(taken[-1]) == name, "somebody else has the old name by now"
                time.sleep(away)
                before = places(virtual)[:12]
                virtual.order(fault="replug", bus="upper")
                back = until_connected(client, BACK)
                assert os.readlink(stable) != name
                figures.append((away, seen, back))
                status = client.call("GetStatus")["status"]
                assert status["state"] == "fault"
                now = places(virtual)[:12]
                assert max(abs(one - other) for one, other in zip(now, before, strict=True)) <= 2
            assert client.call("GetStatus")["status"]["armed"] is True
            assert all(servo["torque"] for servo in virtual.servos())  # the other bus holds on
            assert client.call("Disarm")["state"] == "fault"
            assert not any(servo["torque"] for servo in virtual.servos())
        for fd in taken:
            os.close(fd)
        for away, seen, back in figures:
            print(f"away {away:.2f} s: seen after {seen * 1e3:.0f} ms, identified {back * 1e3:.0f} ms after")
        assert running.end() == 0
