"""The processes of the figures of ROS over Zenoh: who publishes, ours or the peer, and who hears.

`ours | sdk ENDPOINT RATE`, `hears ENDPOINT`. Each says `up`, then answers lines of standard input: who
publishes does so for so many seconds and says what that cost, the other says what came since it was asked.
"""

import json
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

JOINTS = 24
KIND = "sensor_msgs/msg/JointState"
TOPIC = "/hw/joint_states"
SETTLE = 0.5  # s until publisher and reader know each other
NAMES = [f"joint_{place}" for place in range(JOINTS)]


def wanted(endpoint: str) -> dict[str, Any]:
    """The peer's description of the topic; definition and hash are those of rosbags."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    text, _ = store.generate_msgdef(KIND, ros_version=2)
    wanted = {"topic": TOPIC, "msg_type": KIND, "msg_definition": text, "domain_id": 0}
    return wanted | {"type_hash": store.hash_rihs01(KIND), "router_port": int(endpoint.rpartition(":")[2])}


def ours(endpoint: str) -> Callable[[int], None]:
    """One message by our back end."""
    from twind.bridge.ros.discovery import DiscoverySettings
    from twind.bridge.ros.ros_endpoints import HW_JOINTS, SERVICES, TOPICS
    from twind.bridge.ros.zenoh import ZenohTransport
    from twind.ros import JointStateBuffer

    node = ZenohTransport(DiscoverySettings(), lambda line: None, endpoint)
    node.open(TOPICS, SERVICES, lambda topic, data: None, lambda service, data: (True, ""))
    buffer = JointStateBuffer(NAMES, velocity=True, effort=True)

    def send(number: int) -> None:
        row = [number * 1e-3 + place for place in range(JOINTS)]
        node.publish(HW_JOINTS, buffer.fill(time.time_ns(), row, row, row))

    return send


def sdk(endpoint: str) -> Callable[[int], None]:
    """One message by the peer's publisher."""
    import numpy as np
    from zenoh_ros2_sdk import ROS2Publisher
    from zenoh_ros2_sdk.session import ZenohSession

    publisher = ROS2Publisher(**wanted(endpoint))
    types = ZenohSession.get_instance().store.types
    header = types["std_msgs/msg/Header"]
    stamp = types["builtin_interfaces/msg/Time"]

    def send(number: int) -> None:
        row = np.array([number * 1e-3 + place for place in range(JOINTS)])
        now = stamp(*divmod(time.time_ns(), 10**9))
        publisher.publish(header=header(now, ""), name=NAMES, position=row, velocity=row, effort=row)

    return send


def publish(send: Callable[[int], None], rate: float, seconds: float) -> Mapping[str, float]:
    """`sent` messages; `cpu`: share of a core, all threads; `call`: s of one call on average."""
    count = round(rate * seconds)
    within = 0.0
    begun = time.monotonic()
    cpu = time.process_time()
    for number in range(count):
        called = time.monotonic()
        send(number)
        within += time.monotonic() - called
        time.sleep(max(0.0, begun + (number + 1) / rate - time.monotonic()))
    share = (time.process_time() - cpu) / (time.monotonic() - begun)
    return {"sent": count, "cpu": share, "call": within / count}


def subscribe(endpoint: str) -> Callable[[], Mapping[str, Any]]:
    """Count of messages since the last question, and sorted s from stamp to decoded."""
    from zenoh_ros2_sdk import ROS2Subscriber

    ways: list[float] = []

    def on_message(message: Any) -> None:
        stamp = message.header.stamp
        ways.append((time.time_ns() - (stamp.sec * 10**9 + stamp.nanosec)) / 1e9)

    subscriber = ROS2Subscriber(callback=on_message, **wanted(endpoint))

    def latency_summary() -> Mapping[str, Any]:
        assert subscriber is not None
        came = sorted(ways)
        ways[:] = []
        ranks = {str(rank): came[int(rank * (len(came) - 1))] if came else None for rank in (0.5, 0.99, 1.0)}
        return {"count": len(came), "way": ranks}

    return latency_summary


def main(what: str, endpoint: str, rate: str = "0") -> None:
    """Answer until standard input ends."""
    if what == "hears":
        told = subscribe(endpoint)
        print("up", flush=True)
        for _ in sys.stdin:
            print(json.dumps(told()), flush=True)
        return
    send = ours(endpoint) if what == "ours" else sdk(endpoint)
    time.sleep(SETTLE)
    print("up", flush=True)
    for line in sys.stdin:
        print(json.dumps(publish(send, float(rate), float(line))), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
