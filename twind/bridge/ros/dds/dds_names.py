"""Names of ROS 2 on DDS, and the message by which a node appears in its graph. Pure.

After rmw_cyclonedds' rmw_node.cpp and rmw_dds_common.
"""

from __future__ import annotations

from collections.abc import Sequence

from twind.bridge.ros.ros_endpoints import RosTopic
from twind.bridge.ros.ros_names import NodeName
from twind.ros import PARTICIPANT_ENTITIES, encode, participant_entities, type_hash

ENCLAVE = b"enclave=/;"  # USER_DATA of a participant: without it no node of it is listed
GRAPH = RosTopic("ros_discovery_info", PARTICIPANT_ENTITIES, out=True, depth=1, latched=True)
# bytes
GID = 16
GID_HUMBLE = 24


def dds_name(topic: RosTopic, node: NodeName) -> str:
    """Return the DDS name: `/joint_states` is `rt/joint_states`; the graph's own topic has no prefix."""
    return topic.name if topic is GRAPH else f"rt{node.full(topic.name)}"


def user_data(topic: RosTopic) -> bytes:
    """USER_DATA of an endpoint: the hash of its type. Humble ignores it."""
    return f"typehash={type_hash(topic.kind)};".encode()


def graph_message(node: NodeName, participant: bytes, writers: Sequence[bytes], gid: int) -> bytes:
    """CDR: one participant with one node that has these writers and no reader.

    `participant`, `writers`: GUIDs of 16 bytes. `gid`: bytes of a gid in this graph.
    """

    def wide(guid: bytes) -> dict[str, list[int]]:
        return {"data": list(guid.ljust(gid, b"\0"))}

    entities = {
        "node_namespace": node.namespace or "/",
        "node_name": node.node,
        "reader_gid_seq": [],
        "writer_gid_seq": [wide(each) for each in writers],
    }
    message = {"gid": wide(participant), "node_entities_info_seq": [entities]}
    return encode(participant_entities(gid), message)
