"""Graphs of rclpy for tests: the real one where `make ros` has made it, else a stand-in under any Python.

A graph has a bridge, `twindctl ros --backend rclpy` on the sockets of a daemon, and peers of other processes.
"""

import json
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tests.support import interpreters
from tests.support import rclpy_environment as ros_peer
from tests.support.dds_domain import free_domain
from tests.support.processes import favour, until

TESTS = Path(__file__).parents[1]
STAND_IN = TESTS / "support/ros_stand_in"
REAL = "real"  # instead of the version of a Python
PATIENCE = 60.0  # s for an answer of a busy machine


class Graph:
    """One domain and one interpreter. Skips where there is none."""

    def __init__(self, whose: str, folder: Path) -> None:
        self._stack = ExitStack()
        self._begun = 0
        self.folder = folder
        self.whose = whose
        self.python = ros_peer.python() if whose == REAL else interpreters.python(whose)
        domain = self._stack.enter_context(free_domain())
        self.environment = ros_peer.environment(folder, domain)
        if whose == REAL:
            self.environment["AMENT_PREFIX_PATH"] = str(ros_peer.PREFIX)
        else:
            self._stand_in(folder / "prefix")

    def _stand_in(self, prefix: Path) -> None:
        """Laid out as a distribution has it: the launcher finds both the packages and their interpreter."""
        packages = prefix / "lib" / f"python{self.whose}" / "site-packages"
        packages.parent.mkdir(parents=True)
        packages.symlink_to(STAND_IN)
        (prefix / "bin").mkdir()
        (prefix / "bin" / f"python{self.whose}").symlink_to(self.python)
        (self.folder / "nodes").mkdir()
        self.environment |= {
            "AMENT_PREFIX_PATH": str(prefix),
            "PYTHONPATH": str(packages),
            "ROS_STAND_IN": str(self.folder / "nodes"),
        }

    def bridge(self, sockets: Path, *words: str) -> "Bridge":
        """`twindctl ros --backend rclpy`, begun; it ends with the graph."""
        command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(sockets)]
        bridge = Bridge(self, [*command, "ros", "--backend", "rclpy", *words])
        self._stack.callback(bridge.kill)
        return bridge

    def peer(self) -> "Peer":
        """A node of another process."""
        peer = Peer([self.python, str(TESTS / "support/ros_node_peer.py")], self._with_twind())
        self._stack.callback(peer.close)
        return peer

    def run(self, program: str, *words: str) -> "subprocess.Popen[str]":
        """A program of ours under the interpreter of this graph; it ends with the graph."""
        process = subprocess.Popen(
            [self.python, "-c", program, *words],
            env=self._with_twind(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

        def end() -> None:
            process.kill()
            process.communicate()

        self._stack.callback(end)
        return process

    def number(self) -> int:
        """Another each time."""
        self._begun += 1
        return self._begun

    def close(self) -> None:
        """End all that was begun here."""
        self._stack.close()

    def _with_twind(self) -> dict[str, str]:
        paths = [self.environment.get("PYTHONPATH", ""), str(TESTS.parent)]
        return self.environment | {"PYTHONPATH": ":".join(path for path in paths if path)}


class Bridge:
    """The process, and what it says."""

    def __init__(self, graph: Graph, command: list[str]) -> None:
        self.log = graph.folder / f"bridge-{graph.number()}"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                command, env=graph.environment, stdin=subprocess.DEVNULL, stderr=log, stdout=log
            )
        favour(self.process)

    def says(self, text: str) -> str:
        """Wait until that is in its output, and return the output."""

        def look() -> str | None:
            said = self.log.read_text()
            assert text in said or self.process.poll() is None, said
            return said if text in said else None

        return until(look, PATIENCE, text)

    def end(self) -> tuple[int, float]:
        """Its exit code after SIGTERM, and s until then."""
        begun = time.monotonic()
        self.process.terminate()
        return self.process.wait(PATIENCE), time.monotonic() - begun

    def kill(self) -> None:
        """At once, if it has not ended."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(PATIENCE)


class Peer:
    """`ros_node_peer.py`, asked from a test."""

    def __init__(self, command: list[str], environment: dict[str, str]) -> None:
        self._process = subprocess.Popen(
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __getattr__(self, order: str) -> Any:
        return lambda **parameters: self._ask(order, parameters)

    def _ask(self, order: str, parameters: dict[str, Any]) -> Any:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps({"do": order, **parameters}) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, f"the peer ended at {order}: {self._process.wait(PATIENCE)}"
        return json.loads(line)

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.communicate()


def here() -> str:
    """The version of the Python that runs the tests, as a graph is named."""
    return ".".join(map(str, sys.version_info[:2]))
