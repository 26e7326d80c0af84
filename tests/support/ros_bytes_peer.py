"""A ROS node over Zenoh for tests of the bridge as a whole. Its argument: the endpoint.

It joins by twind's own Zenoh session, in a process of its own; peers that share no code with it are in
`ros_zenoh_peer.py`.
"""

import sys
import threading
from collections import deque
from dataclasses import replace
from typing import Any

from tests.support.json_line_process import JsonLineProcess, obey
from twind.bridge.ros.discovery import DiscoverySettings
from twind.bridge.ros.ros_endpoints import TOPICS, RosTopic
from twind.bridge.ros.zenoh import ZenohTransport
from twind.ros import decode, encode

THEIRS = {topic.name: replace(topic, out=not topic.out) for topic in TOPICS}  # as a peer has them


class Peer(JsonLineProcess):
    """The process, asked from a test."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(__name__, endpoint)


class Node:
    """Commands of the process: each public method is one."""

    def __init__(self, endpoint: str) -> None:
        self._heard: dict[str, deque[bytes]] = {name: deque(maxlen=10_000) for name in THEIRS}
        self._graph = ZenohTransport(DiscoverySettings(), lambda line: None, endpoint)
        self._graph.open(list(THEIRS.values()), (), self._hear, lambda *_: (False, ""))

    def received(self, topic: str) -> list[Any]:
        """Messages that came since this was last asked."""
        waiting = self._heard[topic]
        return [decode(THEIRS[topic].kind, waiting.popleft()) for _ in range(len(waiting))]

    def send(self, topic: str, message: dict[str, Any], times: int = 1) -> None:
        """Publish one message so often."""
        data = encode(THEIRS[topic].kind, message)
        for _ in range(times):
            self._graph.publish(THEIRS[topic], data)

    def send_bytes(self, topic: str, data: str) -> None:
        """Publish these bytes, hexadecimal."""
        self._graph.publish(THEIRS[topic], bytes.fromhex(data))

    def flood(self, topic: str, data: str, gap: float) -> None:
        """Publish the bytes of the file `data` every `gap` s, until the process ends."""
        with open(data, "rb") as file:
            message = file.read()

        def run() -> None:
            pause = threading.Event()
            while not pause.wait(gap):
                self._graph.publish(THEIRS[topic], message)

        threading.Thread(target=run, daemon=True).start()

    def _hear(self, topic: RosTopic, data: bytes) -> None:
        self._heard[topic.name].append(data)


if __name__ == "__main__":
    obey(Node(sys.argv[1]))
