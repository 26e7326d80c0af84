"""Options of the robot and of the leader, registered as types `twind` and `twind_leader`."""

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig


@RobotConfig.register_subclass("twind")
@dataclass(kw_only=True)
class TwindRobotConfig(RobotConfig):
    """A robot that a twind daemon drives."""

    socket: str | None = None  # folder of the daemon's sockets; None: the usual places
    fps: int = 30  # rate of the control loop, Hz
    take: bool = False  # take the lease from another client
    arm: bool = False  # arm when connecting
    disarm: bool = False  # disarm when disconnecting
    approach: bool = True  # move slowly to the first action
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


@TeleoperatorConfig.register_subclass("twind_leader")
@dataclass(kw_only=True)
class TwindLeaderConfig(TeleoperatorConfig):
    """A limp arm that is moved by hand and read through twind."""

    socket: str | None = None
    joints: dict[str, str] = field(default_factory=dict)  # leader's joint -> joint of the action
