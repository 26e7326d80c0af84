"""A robot kept moving through the socket: lease, torque, one slow trajectory after the other."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bench.daemon import BenchDaemon
from twind.client import Client, ClientError, Refused

SPAN = 50.0  # s of one trajectory
STEPS = 50
SIZE = 0.05  # rad, either side of where the robot stands
PATIENCE = 30.0  # s that arming may be refused for what passes by itself
PASSING = frozenset(
    {
        "LEASE_MISSING",  # it lapsed while the machine was away
        "THERMAL_HEADROOM",  # not read yet, as is the next
        "VOLTAGE_LOW",
        "BUS_ERRORS",
        "LOOP_LATE",
        "STATE_STALE",
        "LATENCY_BLOCK",
        "TIME_GAP",
        "HW_DISCONNECTED",
    }
)


@contextmanager
def armed(daemon: BenchDaemon) -> Iterator[Client]:
    """A connection that holds the lease of an armed robot; disarmed at the end."""
    with daemon.client() as client:
        _arm(client)
        try:
            yield client
        finally:
            client.call("Disarm")


def _arm(client: Client) -> None:
    """The lease, then torque; asked again while a busy machine is the reason why not. Raises Refused."""
    until = time.monotonic() + PATIENCE
    while True:
        try:
            client.call("AcquireLease")
            client.call("Arm")
            return
        except Refused as refusal:
            codes = {each["code"] for each in refusal.findings}
            if not codes <= PASSING or time.monotonic() > until:
                raise
        time.sleep(0.1)


@contextmanager
def kept_moving(daemon: BenchDaemon) -> Iterator[None]:
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
        except Refused as refusal:  # of a busy machine: asked again, so that it goes on moving
            if not ended.is_set() and not {each["code"] for each in refusal.findings} <= PASSING:
                raise
            time.sleep(0.1)
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
