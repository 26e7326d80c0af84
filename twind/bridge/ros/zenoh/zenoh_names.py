"""Names of a node and its endpoints on Zenoh, after `rmw_zenoh_cpp` (liveliness_utils.cpp). Pure.

A message goes to `DOMAIN/TOPIC/TYPE/HASH`. Endpoints announce themselves by liveliness tokens, `@ros2_lv/…`,
in which a slash of a name becomes `%`. Quality is written out in full: omitted parts mean the reader's
defaults, and those have changed between releases.
"""

from __future__ import annotations

from dataclasses import dataclass

import xxhash

from twind.bridge.ros.ros_endpoints import RosService, RosTopic
from twind.bridge.ros.ros_names import ROOT_NODE, NodeName
from twind.ros import dds_type, type_hash

NO_HASH = "TypeHashNotSupported"  # in place of a hash among nodes of Humble, whose messages have none
_NODE_ID = 0  # this bridge is one node
_ROOT = "%"  # no enclave; a slash of a name is written so
_SERVICE_DEPTH = 10  # rmw_qos_profile_services_default


@dataclass(frozen=True, slots=True)
class ZenohNames:
    """The names of one session's node. `zid`: of the session; `hashed`: types have hashes, as since Iron."""

    domain: int
    zid: str
    hashed: bool = True
    node: NodeName = ROOT_NODE

    def key(self, endpoint: RosTopic | RosService) -> str:
        """Return the key of a topic's messages, or of a service's requests."""
        return f"{self.domain}/{self.node.full(endpoint.name).strip('/')}/{self._type(endpoint.kind)}"

    def node_token(self) -> str:
        """The token of the node."""
        return f"{self._session()}/{_NODE_ID}/NN/{self._node()}"

    def token(self, number: int, endpoint: RosTopic | RosService) -> str:
        """The token of an endpoint; `number` is its own among those of the session, not the node's."""
        if isinstance(endpoint, RosTopic):
            kind = "MP" if endpoint.out else "MS"
            depth = endpoint.depth
            durability = 1 if endpoint.latched else 2
        else:
            kind = "SS"
            depth = _SERVICE_DEPTH
            durability = 2
        quality = f"1:{durability}:1,{depth}:,:,:,,"  # reliable, keep last; no deadline, lifespan, lease
        name = self.node.full(endpoint.name).replace("/", "%")
        return (
            f"{self._session()}/{number}/{kind}/{self._node()}/{name}/{self._type(endpoint.kind)}/{quality}"
        )

    def _session(self) -> str:
        return f"@ros2_lv/{self.domain}/{self.zid}/{_NODE_ID}"

    def _node(self) -> str:
        """Enclave, namespace and name."""
        namespace = self.node.namespace.replace("/", "%") or _ROOT
        return f"{_ROOT}/{namespace}/{self.node.node}"

    def _type(self, kind: str) -> str:
        return f"{dds_type(kind)}/{type_hash(kind) if self.hashed else NO_HASH}"


def gid(token: str) -> bytes:
    """Return 16 bytes, the endpoint's id, which each reader of its token computes in the same way."""
    return xxhash.xxh3_128(token.encode()).intdigest().to_bytes(16, "little")
