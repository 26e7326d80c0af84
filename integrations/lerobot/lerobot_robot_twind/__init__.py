"""Plug-in of LeRobot: a robot and a leader behind twind."""

from lerobot_robot_twind.config_twind import TwindLeaderConfig, TwindRobotConfig
from lerobot_robot_twind.twind_leader import TwindLeader
from lerobot_robot_twind.twind_robot import TwindRobot

__all__ = ["TwindLeader", "TwindLeaderConfig", "TwindRobot", "TwindRobotConfig"]
