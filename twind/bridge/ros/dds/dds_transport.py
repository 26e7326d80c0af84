"""ROS 2 node on DDS without ROS, which only publishes: its writers and its place in the graph.

It has no subscription: of `ros2 topic pub --once` 2 of 15 trajectories and 1 of 10 e-stops arrived, probably
because the writer matches the reader before the reader matches the writer. It has no service: each vendor
pairs requests and replies in its own way.
"""

from __future__ import annotations

import ctypes as ct
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from twind.bridge.ros.dds.dds_config import configuration, participants
from twind.bridge.ros.dds.dds_endpoints import DdsWriter, guid
from twind.bridge.ros.dds.dds_library import checked, load
from twind.bridge.ros.dds.dds_names import ENCLAVE, GID, GID_HUMBLE, GRAPH, graph_message
from twind.bridge.ros.dds.loopback_only import keep_here, sockets
from twind.bridge.ros.discovery import DiscoverySettings
from twind.bridge.ros.ros_endpoints import RosService, RosTopic
from twind.bridge.ros.ros_names import NodeName
from twind.bridge.ros.ros_transport import MessageHandler, RequestHandler
from twind.exceptions import OperationFailed


class DdsTransport:
    """A `Transport` by Cyclone DDS. One per process and domain."""

    refuses = (
        "DDS without ROS takes no commands and no e-stop, since it would lose some; "
        "--backend rclpy and --backend zenoh take them"
    )

    def __init__(
        self, discovery: DiscoverySettings, tell: Callable[[str], None], name: NodeName | None = None
    ) -> None:
        """Make the transport; `tell` receives a line for standard error, from any thread."""
        self._name = name or NodeName()
        self.node = str(self._name)
        self._discovery = discovery
        self._tell = tell
        self._library: ct.CDLL | None = None
        self._domain = 0
        self._writers: dict[str, DdsWriter] = {}
        self._counting = threading.Lock()
        self.dropped = 0  # messages that found no room within `ends.BLOCKING`

    def open(
        self,
        topics: Sequence[RosTopic],
        services: Sequence[RosService],
        on_message: MessageHandler,
        asked: RequestHandler,
    ) -> None:
        """Join the graph and write the outbound topics. Nothing else is created. Raises OperationFailed."""
        self.close()
        self._library = load()
        try:
            self._join(self._library, [topic for topic in topics if topic.out])
        except OperationFailed:
            self.close()
            raise

    def publish(self, topic: RosTopic, data: bytes) -> None:
        """Send CDR bytes, header included; dropped and counted after 5 ms. Raises OperationFailed."""
        writer = self._writers.get(topic.name)
        if writer is None:
            raise OperationFailed(f"dds: {topic.name}: no such topic is open")
        if not writer.write(data):
            with self._counting:
                self.dropped = dropped = self.dropped + 1
            if str(dropped).strip("0") == "1":  # at 1, 10, 100 …: a slow reader stays slow
                self._tell(f"dds: {topic.name}: a reader does not keep up; {dropped} messages dropped")

    def show(self, topic: RosTopic, content: Mapping[str, Any]) -> None:
        """Nothing: JSON is all that it sends."""

    def close(self) -> None:
        """Leave the graph. May be called twice."""
        for writer in self._writers.values():
            writer.close()
        self._writers = {}
        domain = self._domain
        self._domain = 0
        if domain and self._library is not None:
            self._library.dds_delete(domain)

    def _join(self, library: ct.CDLL, topics: Sequence[RosTopic]) -> None:
        participant = self._participant(library)
        writers = [DdsWriter(library, participant, topic, self._name) for topic in topics]
        graph = DdsWriter(library, participant, GRAPH, self._name)
        self._writers = {writer.topic.name: writer for writer in (*writers, graph)}
        # Gids of all endpoints but the graph's own, as in rmw_dds_common: that one belongs to no node.
        gids = [each.guid() for each in writers]
        width = GID_HUMBLE if self._discovery.humble else GID
        self.publish(GRAPH, graph_message(self._name, guid(library, participant), gids, width))

    def _participant(self, library: ct.CDLL) -> int:
        number = self._discovery.domain
        settings = configuration(self._discovery, os.environ.get("CYCLONEDDS_URI", ""))
        before = sockets()
        made = library.dds_create_domain(number, settings.encode() if settings else None)
        doing = (
            f"ROS_DOMAIN_ID={number}: another of this process is in it, or CYCLONEDDS_URI is not well formed"
        )
        self._domain = checked(library, made, doing)
        qos = library.dds_create_qos()
        library.dds_qset_userdata(qos, ENCLAVE, len(ENCLAVE))
        participant = library.dds_create_participant(number, qos, None)
        library.dds_delete_qos(qos)
        most = participants(number)
        doing = f"ROS_DOMAIN_ID={number}: no participant; at most {most} of a domain fit on a machine"
        checked(library, participant, doing)
        if self._discovery.local:
            keep_here(sockets() - before, self._tell)
        return int(participant)
