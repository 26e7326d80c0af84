"""A ROS node over DDS that shares no code with ours, with types of cyclonedds. Its argument: the domain.

It ends with its input. It is on 127.0.0.1 alone, without multicast.
"""

import os
import sys
from typing import Any

from tests.support.json_line_process import JsonLineProcess, obey

CONFIG = (
    '<CycloneDDS><Domain id="any"><General><AllowMulticast>false</AllowMulticast><Interfaces>'
    '<NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces></General><Discovery>'
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>20</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)


class Peer(JsonLineProcess):
    """The process, asked from a test."""

    def __init__(self, domain: int) -> None:
        super().__init__(__name__, str(domain), environment={**os.environ, "CYCLONEDDS_URI": CONFIG})


class Node:
    """The other side: runs in the process of its own."""

    def __init__(self, domain: int) -> None:
        from cyclonedds.domain import DomainParticipant

        self._participant = DomainParticipant(domain)
        self._types = types()
        self._readers: dict[str, Any] = {}
        self._writers: dict[str, Any] = {}

    def listen(self, topic: str, kind: str, *, latched: bool = False) -> None:
        """Read a topic from now on."""
        self._readers[topic] = self._made("Reader", topic, kind, latched=latched)

    def received(self, topic: str) -> list[Any]:
        """Messages since the last question."""
        return [plain(each) for each in self._readers[topic].take(N=10_000)]

    def speak(self, topics: list[tuple[str, str]]) -> None:
        """Offer to write these topics from now on: (name, type)."""
        for topic, kind in topics:
            self._writers[topic] = self._made("Writer", topic, kind)

    def readers(self) -> dict[str, int]:
        """Readers that match, of each topic that is offered."""
        return {topic: len(each.get_matched_subscriptions()) for topic, each in self._writers.items()}

    def _made(self, what: str, topic: str, kind: str, *, latched: bool = False) -> Any:
        from cyclonedds.core import Policy, Qos
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
        qos = Qos(
            Policy.Reliability.Reliable(duration(seconds=1)),
            Policy.History.KeepLast(2000),
            durability,
            Policy.DataRepresentation(use_cdrv0_representation=True),
        )
        made = Topic(self._participant, f"rt{topic}", self._types[kind])
        return (DataReader if what == "Reader" else DataWriter)(self._participant, made, qos=qos)


def plain(value: Any) -> Any:
    """A message as JSON."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, list):
        return [plain(each) for each in value]
    return value


def types() -> dict[str, Any]:
    """The types of messages, written down here anew, by name."""
    from dataclasses import dataclass

    from cyclonedds.idl import IdlStruct
    from cyclonedds.idl.types import float64, int32, sequence, uint32

    @dataclass
    class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
        sec: int32
        nanosec: uint32

    @dataclass
    class Duration(IdlStruct, typename="builtin_interfaces.msg.dds_.Duration_"):
        sec: int32
        nanosec: uint32

    @dataclass
    class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
        stamp: Time
        frame_id: str

    @dataclass
    class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
        header: Header
        name: sequence[str]
        position: sequence[float64]
        velocity: sequence[float64]
        effort: sequence[float64]

    @dataclass
    class Point(IdlStruct, typename="trajectory_msgs.msg.dds_.JointTrajectoryPoint_"):
        positions: sequence[float64]
        velocities: sequence[float64]
        accelerations: sequence[float64]
        effort: sequence[float64]
        time_from_start: Duration

    @dataclass
    class JointTrajectory(IdlStruct, typename="trajectory_msgs.msg.dds_.JointTrajectory_"):
        header: Header
        joint_names: sequence[str]
        points: sequence[Point]

    @dataclass
    class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
        data: str

    return {each.__name__: each for each in (Time, Header, JointState, JointTrajectory, String)}


if __name__ == "__main__":
    obey(Node(int(sys.argv[1])))
