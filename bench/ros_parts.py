"""The publishers of the figures of ROS over DDS: `ours | idl DOMAIN RATE`.

Each says `up`, then publishes for as many seconds as each line of standard input says, and tells the cost.
"""

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

from bench.ros_zenoh_parts import JOINTS, NAMES, SETTLE, publish
from tests.support.ros_dds_peer import types
from twind.bridge.ros.dds import DdsTransport
from twind.bridge.ros.dds.dds_config import configuration
from twind.bridge.ros.discovery import DiscoverySettings
from twind.bridge.ros.ros_endpoints import HW_JOINTS, SERVICES, TOPICS
from twind.ros import JointStateBuffer


def row(number: int) -> list[float]:
    """One column of a message."""
    return [number * 1e-3 + place for place in range(JOINTS)]


def ours(domain: int) -> Callable[[int], None]:
    """One message by our back end."""
    node = DdsTransport(DiscoverySettings(domain=domain), lambda line: None)
    node.open(TOPICS, SERVICES, lambda topic, data: None, lambda service, data: (True, ""))
    buffer = JointStateBuffer(NAMES, velocity=True, effort=True)

    def send(number: int) -> None:
        column = row(number)
        node.publish(HW_JOINTS, buffer.fill(time.time_ns(), column, column, column))

    return send


def idl(domain: int) -> Callable[[int], None]:
    """One message by the typed writer of cyclonedds, as its examples have it."""
    os.environ["CYCLONEDDS_URI"] = str(configuration(DiscoverySettings(domain=domain)))
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    kinds = types()
    Time, Header, JointState = (kinds[name] for name in ("Time", "Header", "JointState"))
    participant: Any = DomainParticipant(domain)
    qos = Qos(Policy.Reliability.Reliable(duration(milliseconds=5)), Policy.History.KeepLast(10))
    writer = DataWriter(participant, Topic(participant, "rt/hw/joint_states", JointState), qos=qos)

    def send(number: int) -> None:
        column = row(number)
        header = Header(Time(*divmod(time.time_ns(), 10**9)), "")
        writer.write(JointState(header, NAMES, column, column, column))

    return send


def main(what: str, domain: str, rate: str) -> None:
    """Publish until standard input ends."""
    send = {"ours": ours, "idl": idl}[what](int(domain))
    time.sleep(SETTLE)
    print("up", flush=True)
    for line in sys.stdin:
        print(json.dumps(publish(send, float(rate), float(line))), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
