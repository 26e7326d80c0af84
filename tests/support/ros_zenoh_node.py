"""Our node in the graph over Zenoh, and what came to it, for tests that meet it with a peer."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tests.support.processes import PATIENCE
from twind.bridge.ros.discovery import DiscoverySettings
from twind.bridge.ros.ros_endpoints import (
    SERVICES,
    SET_LIVE,
    TOPICS,
    RosService,
    RosTopic,
)
from twind.bridge.ros.ros_transport import Reply
from twind.bridge.ros.zenoh import ZenohTransport
from twind.ros import STRING, encode


class Us:
    """Our node, and what came to it."""

    def __init__(self, endpoint: str) -> None:
        self.heard: list[tuple[RosTopic, bytes]] = []
        self.asked: list[tuple[RosService, bool | None]] = []
        self.told: list[str] = []
        self.hold = threading.Event()  # set: requests are answered
        self.hold.set()
        self.held = SET_LIVE  # whose requests wait for that
        self.fails = False  # what comes and is asked for
        self.node = ZenohTransport(DiscoverySettings(), self.told.append, endpoint)

    def join(self) -> None:
        self.node.open(TOPICS, SERVICES, self._hear, self._answer)

    def say(self, topic: RosTopic, text: str) -> None:
        self.node.publish(topic, encode(STRING, {"data": text}))

    def _hear(self, topic: RosTopic, data: bytes) -> None:
        self.heard.append((topic, data))
        if self.fails:
            raise OSError("a fault of ours")

    def _answer(self, service: RosService, data: bool | None, reply: Reply) -> None:
        self.asked.append((service, data))
        if self.fails:
            raise OSError("a fault of ours")
        answer = data is not False, f"{service.name}: {data}"
        if service == self.held:
            threading.Thread(target=lambda: (self.hold.wait(PATIENCE), reply(*answer))).start()
        else:
            reply(*answer)


@contextmanager
def joined(endpoint: str) -> Iterator[Us]:
    us = Us(endpoint)
    us.join()
    try:
        yield us
    finally:
        us.hold.set()
        us.node.close()
