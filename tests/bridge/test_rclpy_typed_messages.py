"""Typed messages, by the definitions of the package as a user builds them."""

import sys
from collections.abc import Mapping
from math import isnan
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from twind.bridge.ros.rclpy_typed_messages import TypedMessages
from twind.bridge.ros.ros_endpoints import RESULTS, STATUS

FOLDER = Path(__file__).parents[2] / "integrations/twind_msgs/msg"
TYPES = {"float64": "double", "bool": "boolean", "string[]": "sequence<string>"}


class Node:
    def __init__(self) -> None:
        self.sent: list[tuple[str, Any]] = []

    def create_publisher(self, kind: type, topic: str, depth: int) -> Any:
        return SimpleNamespace(publish=lambda message: self.sent.append((topic, message)))


def message_class(file: Path) -> type:
    rows = [line.split()[:2] for line in file.read_text().splitlines() if line[:1] not in ("#", "")]
    fields = {name: TYPES.get(kind, kind) for kind, name in rows}
    fields |= {name: "sequence<twind_msgs/JointStatus>" for name, kind in fields.items() if "Joint" in kind}
    return type(file.stem, (), {"get_fields_and_field_types": classmethod(lambda cls: fields)})


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Node:
    classes = {file.stem: message_class(file) for file in FOLDER.glob("*.msg")}
    monkeypatch.setitem(sys.modules, "twind_msgs.msg", SimpleNamespace(**classes))
    return Node()


def test_a_status_and_its_joints_have_the_values_of_the_json(node: Node) -> None:
    joint: Mapping[str, Any] = {
        "name": "l_knee",
        "position": 0.5,
        "velocity": None,
        "heard": True,
        "faults": ["hot"],
    }
    status = {
        "robot": "h24",
        "mode": "live",
        "latency_ms": None,
        "faults": [{"code": "ESTOP"}],
        "joints": [joint],
    }
    TypedMessages(node).show(STATUS, status)
    ((topic, message),) = node.sent
    assert topic == "bridge/robot_status" and message.robot == "h24" and message.faults == ["ESTOP"]
    assert isnan(message.latency_ms) and not hasattr(message, "armed")
    (row,) = message.joints
    assert row.position == 0.5 and isnan(row.velocity) and row.heard and row.faults == ["hot"]


def test_a_result_has_the_codes_of_its_findings(node: Node) -> None:
    TypedMessages(node).show(
        RESULTS, {"topic": "/a", "phase": "refused", "findings": [{"code": "POS_LIMIT"}]}
    )
    ((topic, message),) = node.sent
    assert (topic, message.phase, message.findings) == ("bridge/motion_results", "refused", ["POS_LIMIT"])


def test_nothing_is_offered_where_the_package_is_not_built() -> None:
    node = Node()
    TypedMessages(node).show(STATUS, {})
    assert node.sent == []
