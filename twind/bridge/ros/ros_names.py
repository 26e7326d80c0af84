"""Name of the bridge's node, and the full names of its topics and services. Standard library, Python 3.10.

rclpy applies ROS's own arguments itself. The other back ends have no library for it and support `__ns` and
`__node`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from twind.command_line.verb import UsageError

NODE = "twind"  # the node's usual name
ROS_ARGS = "--ros-args"
# Names that no namespace changes: as diagnostic_updater, tf2_ros and rcl have them.
GLOBAL = ("/diagnostics", "/rosout", "/clock", "/tf", "/tf_static")
_NAME = r"[A-Za-z_]\w*"
_RULE = re.compile(rf"__ns:=(?P<namespace>/|(?:/{_NAME})+)|__(?:node|name):=(?P<node>{_NAME})", re.ASCII)


@dataclass(frozen=True, slots=True)
class NodeName:
    """Name of a node. `namespace`: "" (the root) or `/left`."""

    node: str = NODE
    namespace: str = ""

    def __str__(self) -> str:
        """The full name, `/left/twind`."""
        return f"{self.namespace}/{self.node}"

    def full(self, name: str) -> str:
        """Return the full name of a topic or service; `name` as in `ros_endpoints`, with its slash."""
        return name if name in GLOBAL else f"{self.namespace}{name}"


ROOT_NODE = NodeName()


def relative(name: str) -> str:
    """Return the name for a library that applies the namespace itself."""
    return name if name in GLOBAL else name.removeprefix("/")


def node_name(words: Sequence[str]) -> NodeName:
    """Return the name by the words behind `--ros-args`. Raises UsageError for all but names of the node."""
    found = NodeName()
    rest = list(words)
    while rest:
        rule = _RULE.fullmatch(rest[1]) if rest[0] in ("-r", "--remap") and len(rest) > 1 else None
        if rule is None:
            raise UsageError(
                f"{ROS_ARGS} {' '.join(rest[:2])}: this back end takes -r __ns:=/NAME and -r __node:=NAME; "
                "--backend rclpy takes all arguments of ROS"
            )
        namespace = found.namespace if rule["namespace"] is None else rule["namespace"].rstrip("/")
        found = NodeName(rule["node"] or found.node, namespace)
        rest = rest[2:]
    return found
