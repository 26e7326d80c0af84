"""A daemon, its ROS bridge and a ROS peer at one Zenoh router."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from tests.support.processes import Daemon, until
from tests.support.ros_bytes_peer import Peer
from tests.support.zenoh_router import Router

COMMAND = "/cmd/joint_trajectory"
RESULTS = "/bridge/results"
STATUS = "/bridge/status"


class Graph:
    """A daemon, a bridge and a peer at one router."""

    def __init__(self, folder: Path, router: Router, daemon: Daemon, *program: str) -> None:
        self.folder = folder
        self.router = router
        self.daemon = daemon
        self._program = program or ("-m", "twind.ctl.ctl_main")
        self._said: list[dict[str, Any]] = []
        self.bridge = self.begin()
        try:
            self.peer = self.make_peer()
        except BaseException:
            self.bridge.kill()
            self.bridge.wait(10)
            raise

    def __enter__(self) -> "Graph":
        return self

    def __exit__(self, *_: object) -> None:
        self.peer.__exit__(None, None, None)
        self.bridge.kill()
        self.bridge.wait(10)

    def begin(self) -> "subprocess.Popen[bytes]":
        """`twindctl ros`."""
        words = ["--socket", str(self.daemon.sockets), "ros", "--backend", "zenoh"]
        words += ["--zenoh-connect", self.router.endpoint]
        plain = {key: value for key, value in os.environ.items() if not key.startswith(("ROS_", "ZENOH_"))}
        with (self.folder / "bridge").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, *self._program, *words],
                stderr=log,
                env=plain,
            )

    def make_peer(self) -> Peer:
        """A peer that listens and may command."""
        peer = Peer(self.router.endpoint)

        def both() -> bool:
            """One that is refused comes back: each side has found the other."""
            peer.ask("send", topic=COMMAND, message={"header": {"frame_id": "hello"}})
            time.sleep(0.1)
            return bool(peer.ask("received", topic=RESULTS))

        try:
            until(both, 60.0, lambda: f"an answer: {self.log()}")
        except BaseException:
            peer.__exit__(None, None, None)
            raise
        return peer

    def log(self) -> str:
        return (self.folder / "bridge").read_text()

    def command(self, position: float, seconds: int, frame: str, **header: Any) -> None:
        """Move a knee."""
        point = {"positions": [position], "velocities": [0.0], "time_from_start": {"sec": seconds}}
        message = {"header": {"frame_id": frame, **header}, "joint_names": ["l_knee"], "points": [point]}
        self.peer.ask("send", topic=COMMAND, message=message)

    def results(self, **wanted: Any) -> list[dict[str, Any]]:
        """Those that have all that is wanted, of all that came."""
        self._said += [json.loads(each["data"]) for each in self.peer.ask("received", topic=RESULTS)]
        return [each for each in self._said if wanted.items() <= each.items()]

    def result(self, **wanted: Any) -> dict[str, Any]:
        """The first result that has all that is wanted."""
        until(lambda: self.results(**wanted), 30.0, lambda: f"{wanted}: {self._said[-5:]} {self.log()}")
        return self.results(**wanted)[0]

    def states(self, topic: str = "/joint_states") -> list[dict[str, Any]]:
        """All since this was last asked, some at least."""
        found: list[dict[str, Any]] = []

        def look() -> bool:
            found.extend(self.peer.ask("received", topic=topic))
            return bool(found)

        until(look, 30.0, lambda: f"{topic}: {self.log()}")
        return found

    def knee(self) -> float:
        state = self.states()[-1]
        return float(state["position"][state["name"].index("l_knee")])

    def motion(self) -> str:
        return str(self.daemon.status()["motion"])

    def loop(self, when: str) -> dict[str, Any]:
        """Period and counters of the loop, printed."""
        loop: dict[str, Any] = self.daemon.status()["loop"]
        print(f"{when}: {loop['missed']} of {loop['ticks']} ticks missed, p99 {loop['late_p99_us']} us")
        return loop

    def undisturbed(self, before: dict[str, Any]) -> None:
        """The loop ran on since, at its rate but for what other programs of this machine cost it."""
        after = self.loop("after")
        ticks, missed = (after[key] - before[key] for key in ("ticks", "missed"))
        assert ticks > 0 and missed <= 5 + ticks / 50

    def status(self) -> dict[str, Any]:
        """The newest of /bridge/status since this was last asked; empty: none came."""
        found = self.peer.ask("received", topic=STATUS)
        return json.loads(found[-1]["data"]) if found else {}
