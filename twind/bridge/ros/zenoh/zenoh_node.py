"""ROS node over Zenoh, from joining to leaving: publishers, subscribers, services and their tokens."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

import zenoh
import zenoh.ext

from twind.bridge.ros.ros_endpoints import RosService, RosTopic
from twind.bridge.ros.ros_trajectory import LONGEST
from twind.bridge.ros.ros_transport import MessageHandler, RequestHandler
from twind.bridge.ros.zenoh.zenoh_attachment import ZenohAttachment
from twind.bridge.ros.zenoh.zenoh_names import ZenohNames, gid
from twind.bridge.ros.zenoh.zenoh_service import ZenohServiceServer

HEARTBEAT_S = 0.5  # as rmw_zenoh: how soon a reader learns that it missed the last of a latched topic
_END_S = 0.5  # s for what is being handed over when the graph is left


class ZenohNode:
    """One node; its endpoints live as long as it is open. Raises zenoh.ZError where the session fails."""

    def __init__(self, session: zenoh.Session, names: ZenohNames, tell: Callable[[str], None]) -> None:
        """Make the node; `tell` receives a line where handling of a message or request fails."""
        self._session = session
        self._names = names
        self._tell = tell
        self._numbers = itertools.count(1)
        self._tokens = [session.liveliness().declare_token(names.node_token())]
        self._writers: dict[RosTopic, ZenohWriter] = {}
        self._served: list[ZenohServiceServer] = []
        self._hearing: list[threading.Thread] = []

    def offer(self, topics: Sequence[RosTopic], on_message: MessageHandler) -> None:
        """Publish the outgoing topics and subscribe to the others."""
        for topic in topics:
            token = self._token(topic)
            if topic.out:
                channel = _channel(self._session, self._names.key(topic), topic)
                self._writers[topic] = ZenohWriter(channel, gid(token))
            else:
                self._subscribe(topic, on_message)
            self._tokens.append(self._session.liveliness().declare_token(token))

    def serve(self, services: Sequence[RosService], asked: RequestHandler) -> None:
        """Answer requests."""
        for service in services:
            self._served.append(
                ZenohServiceServer(self._session, service, self._names.key(service), asked, self._tell)
            )
            self._tokens.append(self._session.liveliness().declare_token(self._token(service)))

    def put(self, topic: RosTopic, data: bytes) -> None:
        """Send one message, CDR with its header."""
        self._writers[topic].put(data)

    def close(self) -> None:
        """Leave the graph; nodes that watch its tokens notice at once."""
        for served in self._served:
            served.close()
        with suppress(zenoh.ZError):
            self._session.close()
        for thread in self._hearing:
            thread.join(_END_S)

    def _token(self, endpoint: RosTopic | RosService) -> str:
        return self._names.token(next(self._numbers), endpoint)

    def _subscribe(self, topic: RosTopic, on_message: MessageHandler) -> None:
        """Subscribe with KEEP_LAST `depth`: of messages faster than they are taken the oldest is dropped."""
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(topic.depth)
        samples = self._session.declare_subscriber(self._names.key(topic), ring)

        def receive_loop() -> None:
            for sample in samples:
                try:
                    on_message(topic, _bytes(sample.payload))
                except Exception as error:  # noqa: BLE001  the next message may be a stop
                    self._tell(f"zenoh: {topic.name}: a message was lost: {type(error).__name__}: {error}")

        thread = threading.Thread(target=receive_loop, name=f"ros{topic.name}", daemon=True)
        thread.start()
        self._hearing.append(thread)


class ZenohWriter:
    """One publisher. Several threads may send: messages go out in the order of their numbers."""

    def __init__(self, channel: zenoh.Publisher | zenoh.ext.AdvancedPublisher, gid: bytes) -> None:
        self._put: Callable[..., None] = channel.put
        self._gid = gid
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()

    def put(self, data: bytes) -> None:
        """Send a message; a reader's path without room for it within a millisecond drops it."""
        with self._lock:
            beside = ZenohAttachment(next(self._numbers), time.time_ns(), self._gid)
            self._put(data, attachment=beside.pack())


def _bytes(payload: zenoh.ZBytes) -> bytes:
    """Return the bytes of a payload, or LONGEST + 1 zero bytes where it is longer than LONGEST.

    A payload that is too long is not copied; its length alone is kept, so a stop still takes effect.
    """
    return payload.to_bytes() if len(payload) <= LONGEST else bytes(LONGEST + 1)


def _channel(
    session: zenoh.Session, key: str, topic: RosTopic
) -> zenoh.Publisher | zenoh.ext.AdvancedPublisher:
    """Reliable delivery, dropped where there is no room: a reader that hangs delays no other."""
    drop = zenoh.CongestionControl.DROP
    reliable = zenoh.Reliability.RELIABLE
    if not topic.latched:
        return session.declare_publisher(key, congestion_control=drop, reliability=reliable)
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        congestion_control=drop,
        reliability=reliable,
        cache=zenoh.ext.CacheConfig(topic.depth),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S),
        publisher_detection=True,
    )
