"""docs/ros.md: its programs run as printed, with a real daemon, bridge and peers."""

import subprocess
import sys
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.support.doc_pages_text import ROOT, fenced
from tests.support.processes import simulated, until
from tests.support.ros_graphs import REAL, Graph
from tests.support.zenoh_router import free_port

CLIENT, ROUTER = fenced((ROOT / "docs" / "ros.md").read_text(), "python")
PEER = '{mode: "client", connect: {endpoints: ["WHERE"]}, scouting: {multicast: {enabled: false}}}'
JOIN = "import sys, zenoh; zenoh.open(zenoh.Config.from_json5(sys.argv[1])).close()"
TRIES = 6
LATE = "ticks missed in a row"  # of LOOP_LATE: the machine was too busy for the loop, and the motion held


def test_the_client_program_of_the_page_moves_the_robot_and_receives_the_result(tmp_path: Path) -> None:
    with closing(Graph(REAL, tmp_path)) as graph, simulated(tmp_path / "run") as daemon:
        bridge = graph.bridge(daemon.sockets)
        for _ in range(TRIES):
            printed = graph.run(CLIENT).communicate(timeout=120.0)[0]
            phases = [line.split()[0] for line in printed.splitlines()]
            if phases[-1:] != ["aborted"] or LATE not in printed:
                break
        told = bridge.log.read_text()
    assert phases[:1] == ["accepted"] and phases[-1:] == ["succeeded"], (printed, told)
    assert {*phases} <= {"accepted", "replaced", "dropped", "succeeded"}, (printed, told)


@pytest.mark.skipif(find_spec("zenoh") is None, reason="the extra `zenoh` is not installed")
def test_the_router_of_the_page_is_one() -> None:
    where = f"tcp/127.0.0.1:{free_port()}"
    assert "tcp/127.0.0.1:7447" in ROUTER
    router = subprocess.Popen([sys.executable, "-c", ROUTER.replace("tcp/127.0.0.1:7447", where)])
    peer = PEER.replace("WHERE", where)

    def joined() -> bool:
        return (
            subprocess.run([sys.executable, "-c", JOIN, peer], capture_output=True, timeout=60.0).returncode
            == 0
        )

    try:
        until(joined, 60.0, "nobody can join it")
    finally:
        router.kill()
        router.wait(10.0)
