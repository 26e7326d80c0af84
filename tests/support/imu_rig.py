"""A standing robot with an IMU under a fake clock."""

from dataclasses import replace
from typing import Any

from tests.support.daemon_rig import Rig
from twind.config.robot_spec import ImuSpec
from twind.link import Tick
from twind.robot.joint_state import Imu
from twind.robot.modes import Mode


class Standing(Rig):
    """h24-standing on servos without load, its base at rest; `imu` changes the description of the IMU."""

    def __init__(self, mode: Mode = Mode.MIRROR, **imu: Any) -> None:
        self._changes = imu
        super().__init__("h24-standing", mode)

    def _virtual(self, bus: str, start: Any) -> Any:
        if self._changes:
            assert self.robot.imu is not None
            self.robot = replace(self.robot, imu=replace(self.robot.imu, **self._changes))
            self.made = replace(self.made, robot=self.robot)
        return super()._virtual(bus, start)

    @property
    def spec(self) -> ImuSpec:
        assert self.robot.imu is not None
        return self.robot.imu

    @property
    def imu(self) -> Imu:
        found = self.loop.robot.measured.imu
        assert found is not None
        return found

    @property
    def reported_ticks(self) -> list[Tick]:
        return [news for news in self.news if isinstance(news, Tick)]
