"""Zenoh back end of ROS 2: it joins as `rmw_zenoh_cpp` does, without a library of ROS."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import zenoh

from twind.bridge.ros.discovery import DiscoverySettings
from twind.bridge.ros.ros_endpoints import RosService, RosTopic
from twind.bridge.ros.ros_names import NodeName
from twind.bridge.ros.ros_transport import MessageHandler, RequestHandler
from twind.bridge.ros.zenoh.zenoh_config import session_config
from twind.bridge.ros.zenoh.zenoh_names import ZenohNames
from twind.bridge.ros.zenoh.zenoh_node import ZenohNode
from twind.exceptions import OperationFailed

# Settings of the reach of a DDS graph; rmw_zenoh ignores them, too.
_REACH = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY")


class ZenohTransport:
    """`RosTransport` over Zenoh.

    `connect`: the router, several by commas; `config`: a Zenoh configuration file.

    `tell` is given a line when a router is found or lost, from any thread. Of `discovery` domain and
    distribution count. The session's configuration determines its reach, as in rmw_zenoh; the default is this
    machine.
    """

    refuses = ""

    def __init__(
        self,
        discovery: DiscoverySettings,
        tell: Callable[[str], None],
        connect: str | None = None,
        config: Path | str | None = None,
        name: NodeName | None = None,
    ) -> None:
        self._discovery = discovery
        self._name = name or NodeName()
        self.node = str(self._name)
        self._tell = tell
        self._connect = connect
        self._config = config
        self._node: ZenohNode | None = None
        ignored = [name for name in _REACH if os.environ.get(name)]
        if ignored:
            tell(f"zenoh: {', '.join(ignored)}: ignored here; the router decides which nodes join")

    def open(
        self,
        topics: Sequence[RosTopic],
        services: Sequence[RosService],
        on_message: MessageHandler,
        asked: RequestHandler,
    ) -> None:
        """Join the graph. A router that is not there is looked for from then on. Raises OperationFailed."""
        config = session_config(os.environ, self._connect, self._config)
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise OperationFailed(f"zenoh: {error}; --zenoh-connect or --zenoh-config say where to") from None
        try:
            self._watch(session)
            hashed = not self._discovery.humble
            names = ZenohNames(self._discovery.domain, str(session.zid()), hashed=hashed, node=self._name)
            self._node = ZenohNode(session, names, self._tell)
            self._node.offer(topics, on_message)
            self._node.serve(services, asked)
        except zenoh.ZError as error:
            self._node = None
            session.close()
            raise OperationFailed(f"zenoh: {error}") from None

    def publish(self, topic: RosTopic, data: bytes) -> None:
        """Send CDR bytes, header included, within milliseconds. Raises OperationFailed."""
        node = self._node
        if node is None:
            raise OperationFailed(f"zenoh: {topic.name}: the graph is not joined")
        try:
            node.put(topic, data)
        except zenoh.ZError as error:
            raise OperationFailed(f"zenoh: {topic.name}: {error}") from None

    def show(self, topic: RosTopic, content: Mapping[str, Any]) -> None:
        """Nothing: JSON is all that it sends."""

    def close(self) -> None:
        """Leave the graph. May be called twice."""
        node = self._node
        self._node = None
        if node is not None:
            node.close()

    def _watch(self, session: zenoh.Session) -> None:
        """Without a router nodes on this machine do not find each other; those that did go on."""
        if not session.info.routers_zid():
            self._tell("zenoh: no router yet, looking on; `ros2 run rmw_zenoh_cpp rmw_zenohd` starts one")

        def seen(event: zenoh.TransportEvent) -> None:
            if event.transport.whatami == zenoh.WhatAmI.ROUTER:
                there = event.kind == zenoh.SampleKind.PUT
                self._tell(f"zenoh: router {event.transport.zid} {'found' if there else 'lost, looking on'}")

        session.info.declare_transport_events_listener(seen, history=True)
