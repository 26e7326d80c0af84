"""A robot kept moving through the socket: lease, torque, one slow trajectory after the other."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bench.daemon import Daemon
from twind.client import Client, ClientError

SPAN = 50.0  # s of one trajectory
STEPS = 50
SIZE = 0.05  # rad, either side of where the robot stands


@contextmanager
def armed(daemon: Daemon) -> Iterator[Client]:
    """A connection that holds the lease of an armed robot; disarmed at the end."""
    with daemon.client() as client:
        client.call("AcquireLease")
        client.call("Arm")
        try:
            yield client
        finally:
            client.call("Disarm")


@contextmanager
def kept_moving(daemon: Daemon) -> Iterator[None]:
    """Armed, and all joints swing slowly while the context lasts."""
    ended = threading.Event()
    with armed(daemon) as client:
        path = swing(client.call("GetStatus", joints=True)["joints"])
        thread = threading.Thread(target=_follow, args=(client, path, ended))
        thread.start()
        try:
            yield
        finally:
            with daemon.client() as other:
                ended.set()
                other.call("Cancel")
            thread.join()


def _follow(client: Client, path: dict[str, Any], ended: threading.Event) -> None:
    while not ended.is_set():
        try:
            for _ in client.stream("SubmitTrajectory", trajectory=path):
                pass
        except ClientError:
            if not ended.is_set():
                raise


def swing(joints: list[dict[str, Any]]) -> dict[str, Any]:
    """Every joint from where it is towards its zero, or out of it, by `SIZE` and back, slowly."""
    points = [
        {
            "positions": [joint["position"] + _way(joint) * SIZE * (k % 2) for joint in joints],
            "velocities": [0.0] * len(joints),
            "time_from_start": (k + 1) * SPAN / STEPS,
        }
        for k in range(STEPS)
    ]
    return {"joint_names": [joint["name"] for joint in joints], "points": points}


def _way(joint: dict[str, Any]) -> float:
    return -1.0 if joint["position"] > 0.0 else 1.0
