"""A robot of LeRobot that a twind daemon drives: every action passes the gate."""

import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from math import degrees, radians
from typing import Any

from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots import Robot as LeRobotDevice
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_twind.calibrated_by_twind import CalibratedByTwind
from lerobot_robot_twind.config_twind import TwindRobotConfig
from lerobot_robot_twind.readings import fresh_degrees
from twind import Robot
from twind.client import Refused
from twind.client.move_duration import goals_of
from twind.robot_client.goal_stream import GoalStream

logger = logging.getLogger(__name__)
KEY = ".pos"
FAR = 0.5  # rad between a goal and the joint, beyond which it moves slowly; a joint lags by less


class TwindRobot(CalibratedByTwind, LeRobotDevice):
    """Joints in degrees under `JOINT.pos`, and cameras. Calibration is twind's."""

    config_class = TwindRobotConfig
    name = "twind"

    def __init__(self, config: TwindRobotConfig) -> None:
        """Ask the daemon for its joints. Raises NoDaemon."""
        super().__init__(config)
        self.config = config
        self.cameras = make_cameras_from_configs(config.cameras)
        self._robot: Robot | None = None
        self._stream: GoalStream | None = None
        self._approached = False
        self._clipped: set[str] = set()  # joints of which the last action was clipped
        with Robot(config.socket, read_only=True) as robot:
            self.joints = robot.names

    @cached_property
    def action_features(self) -> dict[str, type]:
        """A number for each joint."""
        return {f"{name}{KEY}": float for name in self.joints}

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """Numbers of the joints, and the shape of each camera's picture."""
        pictures = {name: (each.height, each.width, 3) for name, each in self.config.cameras.items()}
        return {**self.action_features, **pictures}

    @property
    def is_connected(self) -> bool:
        """True between `connect` and `disconnect`."""
        return self._robot is not None and all(each.is_connected for each in self.cameras.values())

    def connect(self, calibrate: bool = True) -> None:
        """Take the lease and open the cameras. Raises DeviceNotConnectedError: the robot is not armed."""
        if self._robot is not None:
            raise DeviceAlreadyConnectedError(f"{self} is connected already")
        robot = Robot(self.config.socket, take=self.config.take, disarm=self.config.disarm)
        try:
            if self.config.arm and not robot.armed:
                robot.arm()
            status = robot.status
            if status["mode"] == "live" and not status["armed"]:
                raise DeviceNotConnectedError(
                    f"{robot.name} is {status['state']}, not armed: `twindctl arm`, or --robot.arm=true"
                )
            for camera in self.cameras.values():
                camera.connect()
            self._stream = robot.stream(rate=self.config.fps, clamp=True, strict=False)
            self._stream.__enter__()
        except BaseException:
            robot.close()
            for camera in self.cameras.values():
                if camera.is_connected:
                    camera.disconnect()
            raise
        self._robot = robot
        self._approached = not self.config.approach

    def disconnect(self) -> None:
        """Give the lease back: the robot holds, or is disarmed if so configured."""
        robot, stream = self._connected()
        self._robot = None
        self._stream = None
        try:
            with suppress(Refused):  # of the last action, which was logged
                stream.__exit__(None, None, None)
        finally:
            robot.close()
            for camera in self.cameras.values():
                camera.disconnect()

    def get_observation(self) -> dict[str, Any]:
        """Read joints (degrees) and pictures. Raises DeviceNotConnectedError: a reading is stale."""
        robot, _ = self._connected()
        joints = {f"{name}{KEY}": at for name, at in fresh_degrees(robot).items()}
        return {**joints, **{name: camera.read_latest() for name, camera in self.cameras.items()}}

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Send goals (degrees); return those in force: clipped to limits, or the earlier ones if refused.

        They are written into `action` too: LeRobot records that, not what is returned.
        """
        robot, stream = self._connected()
        goals = {key.removesuffix(KEY): radians(value) for key, value in action.items() if key.endswith(KEY)}
        asked = {name: goals[name] for name in self.joints if name in goals}
        try:
            if not self._approached or self._is_far(robot, asked):
                robot.approach(asked)
                self._approached = True
            changes = stream.send_and_wait(asked)
        except Refused as refusal:
            logger.warning("%s: action refused: %s", robot.name, refusal)
            self._approached = not self.config.approach  # the leader may be elsewhere when it goes on
            in_force = goals_of(robot.state.message.rows)
        else:
            in_force = asked | self._clipped_goals(changes)
        sent = {f"{name}{KEY}": degrees(at) for name in asked if (at := in_force.get(name)) is not None}
        action.update(sent)
        return sent

    def _clipped_goals(self, changes: Sequence[Mapping[str, Any]]) -> dict[str, float]:
        """Return the goals (rad) that the gate clipped; log each joint once, as a leader may rest there."""
        clipped = {each["joint"]: each for each in changes if each["code"] == "POS_LIMIT"}
        for joint in clipped.keys() - self._clipped:
            logger.warning("%s: action clipped: %s", self._connected()[0].name, clipped[joint]["message"])
        self._clipped = set(clipped)
        return {joint: each["bound"] for joint, each in clipped.items()}

    def _is_far(self, robot: Robot, goals: dict[str, float]) -> bool:
        """True where a goal is so far that the robot would go there at full speed."""
        if not self.config.approach:
            return False
        limits = robot.limits
        joints = robot.joints
        for name, goal in goals.items():
            lower, upper = limits[name]
            at = joints[name].position
            if at is None or abs(min(max(goal, lower), upper) - at) > FAR:
                return True
        return False

    def _connected(self) -> tuple[Robot, GoalStream]:
        if self._robot is None or self._stream is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        return self._robot, self._stream
