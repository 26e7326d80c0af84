"""Status and results as messages of the package `twind_msgs`, where it is built. rclpy; Python 3.10.

A field has the name of its key in the JSON of the same topic; a number that is unknown is NaN.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from math import nan
from typing import Any

from twind.bridge.ros.ros_endpoints import RESULTS, STATUS, RosTopic
from twind.bridge.ros.ros_names import relative

PACKAGE = "twind_msgs.msg"
TYPED = {STATUS: ("RobotStatus", "/bridge/robot_status"), RESULTS: ("MotionResult", "/bridge/motion_results")}


class TypedMessages:
    """Publishers of typed messages; none where the package is not built."""

    def __init__(self, node: Any) -> None:
        try:
            self._types = importlib.import_module(PACKAGE)
        except ImportError:
            self._publishers = {}
            return
        self._publishers = {
            topic: node.create_publisher(getattr(self._types, kind), relative(name), topic.depth)
            for topic, (kind, name) in TYPED.items()
        }

    def show(self, topic: RosTopic, content: Mapping[str, Any]) -> None:
        """Publish the content of a topic of JSON."""
        publisher = self._publishers.get(topic)
        if publisher is not None:
            publisher.publish(self._filled(TYPED[topic][0], content))

    def _filled(self, kind: str, content: Mapping[str, Any]) -> Any:
        message = getattr(self._types, kind)()
        for name, type_name in message.get_fields_and_field_types().items():
            value = content.get(name)
            if type_name.endswith("JointStatus>"):
                setattr(message, name, [self._filled("JointStatus", each) for each in value or ()])
            elif type_name == "sequence<string>":
                setattr(
                    message, name, [each if isinstance(each, str) else each["code"] for each in value or ()]
                )
            elif type_name == "double":
                setattr(message, name, nan if value is None else float(value))
            elif value is not None:
                setattr(message, name, value)
        return message
