"""A leader of LeRobot: a limp arm, moved by hand, read through twind."""

from functools import cached_property
from typing import Any

from lerobot.teleoperators import Teleoperator
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_twind.calibrated_by_twind import CalibratedByTwind
from lerobot_robot_twind.config_twind import TwindLeaderConfig
from lerobot_robot_twind.readings import fresh_degrees
from twind import Robot


class TwindLeader(CalibratedByTwind, Teleoperator):
    """Joints in degrees under `JOINT.pos`. It only reads: the arm stays limp."""

    config_class = TwindLeaderConfig
    name = "twind_leader"

    def __init__(self, config: TwindLeaderConfig) -> None:
        """Ask the daemon for its joints. Raises NoDaemon."""
        super().__init__(config)
        self.config = config
        self._robot: Robot | None = None
        with Robot(config.socket, read_only=True) as robot:
            self.joints = robot.names

    @cached_property
    def action_features(self) -> dict[str, type]:
        """A number for each joint."""
        return {self._key(name): float for name in self.joints}

    @property
    def feedback_features(self) -> dict[str, type]:
        """Nothing: a limp arm gives no feedback."""
        return {}

    @property
    def is_connected(self) -> bool:
        """True between `connect` and `disconnect`."""
        return self._robot is not None

    def connect(self, calibrate: bool = True) -> None:
        """Observe the daemon."""
        if self._robot is not None:
            raise DeviceAlreadyConnectedError(f"{self} is connected already")
        self._robot = Robot(self.config.socket, read_only=True, state_rate=100.0)

    def disconnect(self) -> None:
        """End the connection."""
        self._connected().close()
        self._robot = None

    def get_action(self) -> dict[str, float]:
        """Return the positions, degrees. Raises DeviceNotConnectedError: a reading is stale."""
        return {self._key(name): at for name, at in fresh_degrees(self._connected()).items()}

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing."""

    def _connected(self) -> Robot:
        if self._robot is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        return self._robot

    def _key(self, joint: str) -> str:
        return f"{self.config.joints.get(joint, joint)}.pos"
