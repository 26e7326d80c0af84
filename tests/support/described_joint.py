"""A joint as `GetRobot` describes it, as far as motions of one joint need it."""

from typing import Any

JOINT: dict[str, Any] = {
    "name": "elbow",
    "lower": -1.0,
    "upper": 1.0,
    "velocity_limit": 4.0,
    "acceleration_limit": 20.0,
    "type": {"name": "xl430", "heat": {"cool": 47.0}},
}
