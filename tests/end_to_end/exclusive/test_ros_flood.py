"""`twindctl ros` while a peer floods it over Zenoh: what it costs others, and that a stop is a stop."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import simulated, until
from tests.support.zenoh_router import Router
from twind.client import CallError

pytest.importorskip("zenoh", reason="the extra `zenoh` is not installed")
from tests.support.ros_bytes_peer import Peer
from tests.support.zenoh_bridge_graph import COMMAND, RESULTS, Graph


def commands() -> dict[str, bytes]:
    """Messages of a faulty peer, by name."""
    from twind.ros import JOINT_TRAJECTORY, encode

    point = {"positions": [9.0], "velocities": [0.0], "time_from_start": {"sec": 1}}
    moment = [{"time_from_start": {"sec": place // 1000, "nanosec": place % 1000}} for place in range(80_000)]

    def command(**fields: Any) -> bytes:
        whole = {"header": {"frame_id": "mad"}, "joint_names": ["l_knee"], "points": [point]}
        return encode(JOINT_TRAJECTORY, whole | fields)

    return {
        "far": command(),
        "names": command(joint_names=[""] * 260_000),
        "name": command(joint_names=["\x01" * 1_000_000]),
        "points": command(points=moment),
        "frame": command(header={"frame_id": "x" * 1_900_000}),
    }


@contextmanager
def flooded(graph: Graph, folder: Path, what: str, gap: float) -> Iterator[None]:
    """A peer that floods, in a process of its own, from its first answer on. `gap`: s between messages."""
    data = folder / "message"
    data.write_bytes(commands()[what])
    with Peer(graph.router.endpoint) as mad:
        os.setpriority(os.PRIO_PROCESS, mad.process.pid, 19)  # it would have a machine of its own
        mad.ask("flood", topic=COMMAND, data=str(data), gap=gap)
        until(lambda: mad.ask("received", topic=RESULTS), 60.0, "an answer to the peer that floods")
        yield


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    folder = tmp_path_factory.mktemp("flood")
    with (
        simulated(folder / "run") as daemon,
        Router(gossip=True) as router,
        Graph(folder, router, daemon) as graph,
    ):
        yield graph


@pytest.mark.parametrize(
    ("what", "gap"), [("names", 0.05), ("name", 0.05), ("points", 0.05), ("frame", 0.05), ("far", 0.001)]
)
def test_while_a_peer_floods_what_runs_goes_on_and_an_e_stop_is_not_held_up(
    graph: Graph, tmp_path: Path, what: str, gap: float
) -> None:
    away = graph.knee() > 0.5
    graph.command(0.0 if away else 1.0, 3, f"runs {what}")
    graph.result(frame_id=f"runs {what}", phase="accepted")
    with flooded(graph, tmp_path, what, gap):
        graph.result(frame_id=f"runs {what}", phase="succeeded")
        begun = time.monotonic()
        graph.peer.ask("send", topic="/bridge/estop_cmd", message={"data": "settle"})
        until(lambda: graph.daemon.status()["faults"], 40.0, "the e-stop")
        took = time.monotonic() - begun
        print(f"{what}: e-stop latched after {took:.3f} s")
    with graph.daemon.client() as client:
        client.call("Reset")
    assert took < 5.0  # of 12 and more, when all of a message was read before it was measured


def test_a_flood_displaces_other_commands_is_reported_and_ends_with_its_sender(
    graph: Graph, tmp_path: Path
) -> None:
    with flooded(graph, tmp_path, "far", 0.0):
        for place in range(10):
            graph.command(0.1, 1, f"sane {place}")
            time.sleep(0.2)
        assert graph.result(phase="dropped")["count"] > 0
        with graph.daemon.client() as client:

            def acquired() -> bool:
                with suppress(CallError):
                    client.call("AcquireLease")
                    return True
                return False

            until(acquired, 20.0, "the lease, which the flood does not keep")
            client.call("ReleaseLease")
    heard = [place for place in range(10) if graph.results(frame_id=f"sane {place}")]
    print(f"{len(heard)} of 10 sane commands were answered in the flood")
    graph.command(0.2, 1, "after")
    graph.result(frame_id="after", phase="succeeded")


def test_a_foreign_stop_prevents_every_trajectory_submitted_before_it(graph: Graph) -> None:
    joints = graph.states()[-1]["name"][:8]
    with graph.daemon.client() as client:
        client.call("GetStatus")
        for name in joints:
            point = {"positions": [0.05], "velocities": [0.0], "time_from_start": {"sec": 4}}
            message = {"header": {"frame_id": f"q {name}"}, "joint_names": [name], "points": [point]}
            graph.peer.ask("send", topic=COMMAND, message=message)
        until(lambda: graph.motion() == "active", 10.0, "the first of them moves")
        client.call("Cancel")
    for name in joints:
        assert ended(graph, f"q {name}") in ("replaced", "cancelled", "refused")  # none arrives
    assert graph.motion() == "holding"


def ended(graph: Graph, frame: str) -> str:
    """Outcome of a command, once it has one."""
    phases = list[str]()

    def over() -> bool:
        phases[:] = [each["phase"] for each in graph.results(frame_id=frame) if each["phase"] != "accepted"]
        return bool(phases)

    until(over, 20.0, f"the end of {frame}")
    return phases[-1]
