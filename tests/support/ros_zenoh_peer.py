"""A ROS node over Zenoh that shares no code with ours: zenoh-ros2-sdk alone. Its argument: the port.

It ends with its input.
Definitions and hashes are rosbags', hashes of services those that ROS itself gives: it clones nothing.
"""

import sys
import time
from typing import Any

from tests.support.json_line_process import JsonLineProcess, obey

HASHES = {
    "std_srvs/srv/Trigger": "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "std_srvs/srv/SetBool": "RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
}
REQUESTS = {
    "std_srvs/srv/Trigger": "uint8 structure_needs_at_least_one_member",
    "std_srvs/srv/SetBool": "bool data",
}
RESPONSE = "bool success\nstring message"


class Peer(JsonLineProcess):
    """The process, asked from a test."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(__name__, endpoint.rpartition(":")[2])


class Node:
    """Commands of the process: each method is one."""

    def __init__(self, port: int) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._port = port
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._heard: dict[str, list[Any]] = {}
        self._writers: dict[str, Any] = {}
        self._kept: list[Any] = []

    def _wanted(self, topic: str, kind: str) -> dict[str, Any]:
        text, _ = self._store.generate_msgdef(kind, ros_version=2)
        wanted = {"topic": topic, "msg_type": kind, "msg_definition": text, "domain_id": 0}
        return wanted | {"type_hash": self._store.hash_rihs01(kind), "router_port": self._port}

    def hear(self, topic: str, kind: str, qos: str | None = None) -> None:
        """Keep what comes on a topic, each with when it came, ns since 1970."""
        from zenoh_ros2_sdk import ROS2Subscriber

        heard = self._heard[topic] = []
        self._kept.append(
            ROS2Subscriber(
                callback=lambda m: heard.append((time.time_ns(), m)), qos=qos, **self._wanted(topic, kind)
            )
        )

    def received(self, topic: str) -> list[Any]:
        """Messages as plain objects."""
        return [plain(message) for _, message in list(self._heard[topic])]

    def counted(self, topic: str) -> dict[str, Any]:
        """Count of messages, and the time of each from its stamp to arrival, s, sorted."""
        came = list(self._heard[topic])
        stamps = [(when, each.header.stamp) for when, each in came]
        return {
            "count": len(came),
            "late": sorted(when / 1e9 - (s.sec + s.nanosec / 1e9) for when, s in stamps),
        }

    def say(self, topic: str, kind: str, message: dict[str, Any]) -> None:
        """Send a message, its nested ones as dicts with their type under `_`."""
        from zenoh_ros2_sdk import ROS2Publisher
        from zenoh_ros2_sdk.session import ZenohSession

        if topic not in self._writers:
            self._writers[topic] = ROS2Publisher(**self._wanted(topic, kind))
            time.sleep(0.3)  # until it is known where its readers are
        types = ZenohSession.get_instance().store.types
        self._writers[topic].publish(**{key: made(types, value) for key, value in message.items()})

    def call(self, service: str, kind: str, request: dict[str, Any]) -> Any:
        """The answer of a service, None: none came."""
        from zenoh_ros2_sdk import ROS2ServiceClient

        client = ROS2ServiceClient(
            service,
            kind,
            REQUESTS[kind],
            RESPONSE,
            domain_id=0,
            router_port=self._port,
            type_hash=HASHES[kind],
            timeout=5.0,
        )
        try:
            return plain(client.call(**request))
        finally:
            client.close()

    def hear_latched(self, topic: str, kind: str) -> None:
        """As a TRANSIENT_LOCAL subscription of rmw_zenoh is declared (read: rmw_subscription_data.cpp)."""
        import zenoh.ext
        from zenoh_ros2_sdk.keyexpr import topic_keyexpr
        from zenoh_ros2_sdk.session import ZenohSession
        from zenoh_ros2_sdk.utils import ros2_to_dds_type

        session = ZenohSession.get_instance("127.0.0.1", self._port)
        session.register_message_type(self._wanted(topic, kind)["msg_definition"], kind)
        heard = self._heard[topic] = []

        def hear(sample: Any) -> None:
            message = session.store.deserialize_cdr(sample.payload.to_bytes(), kind)
            heard.append((time.time_ns(), message))

        self._kept.append(
            zenoh.ext.declare_advanced_subscriber(
                session.session,
                topic_keyexpr(0, topic, ros2_to_dds_type(kind), self._store.hash_rihs01(kind)),
                hear,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
                recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                subscriber_detection=True,
            )
        )

    def raw(self, topic: str, kind: str, data: str, attachment: str | None) -> None:
        """Any bytes on a topic, hexadecimal."""
        from zenoh_ros2_sdk.keyexpr import topic_keyexpr
        from zenoh_ros2_sdk.session import ZenohSession
        from zenoh_ros2_sdk.utils import ros2_to_dds_type

        key = topic_keyexpr(0, topic, ros2_to_dds_type(kind), self._store.hash_rihs01(kind))
        beside = None if attachment is None else bytes.fromhex(attachment)
        session = ZenohSession.get_instance("127.0.0.1", self._port).session
        session.put(key, bytes.fromhex(data), attachment=beside)

    def query(self, service: str, kind: str, data: str, attachment: str | None) -> Any:
        """Any request, hexadecimal: what is replied, bytes and attachment or error."""
        from zenoh_ros2_sdk.keyexpr import topic_keyexpr
        from zenoh_ros2_sdk.session import ZenohSession
        from zenoh_ros2_sdk.utils import ros2_to_dds_type

        given = None if attachment is None else bytes.fromhex(attachment)
        session = ZenohSession.get_instance("127.0.0.1", self._port).session
        key = topic_keyexpr(0, service, ros2_to_dds_type(kind), HASHES[kind])
        for reply in session.get(key, payload=bytes.fromhex(data), attachment=given, timeout=5.0):
            if reply.err is not None:
                return {"error": reply.err.payload.to_string()}
            told = reply.ok
            beside = None if told.attachment is None else told.attachment.to_bytes().hex()
            return {"data": told.payload.to_bytes().hex(), "attachment": beside}
        return None

    def topics(self) -> Any:
        """Names and types, as `ros2 topic list --show-types` has them."""
        from zenoh_ros2_sdk.discovery import get_topic_names_and_types

        return get_topic_names_and_types(domain_id=0, router_port=self._port, timeout=2.0)

    def endpoints(self, kind: str) -> Any:
        """Every endpoint of a kind (MP, MS, SS), as its token says."""
        from zenoh_ros2_sdk.discovery import _query_liveliness
        from zenoh_ros2_sdk.qos import QosProfile
        from zenoh_ros2_sdk.session import ZenohSession

        found = _query_liveliness(ZenohSession.get_instance("127.0.0.1", self._port), 0, kind, 2.0)
        return [each | {"qos": str(QosProfile.decode(each["qos"]))} for each in found]


def made(types: Any, value: Any) -> Any:
    """Objects of dicts that name their type, arrays of lists of floats."""
    import numpy as np

    if isinstance(value, list) and all(isinstance(each, float) for each in value):
        return np.array(value, np.float64)
    if isinstance(value, list):
        return [made(types, each) for each in value]
    if isinstance(value, dict):
        return types[value["_"]](**{k: made(types, v) for k, v in value.items() if k != "_"})
    return value


def plain(value: Any) -> Any:
    """Dicts and lists of a message."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(each) for each in value] if isinstance(value, list) else value


if __name__ == "__main__":
    obey(Node(int(sys.argv[1])))
