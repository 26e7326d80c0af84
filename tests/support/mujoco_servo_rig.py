"""A daemon on servos that MuJoCo moves, whose robot need not be as its file says; under a fake clock."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from tests.support.daemon_rig import Rig
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.robot.trajectory import Trajectory
from twind.twin.mujoco_physics import BusPhysics, MujocoPhysics
from twind.virtual.robot_ground_truth import RobotGroundTruth
from twind.virtual.virtual_robot_spec import buses
from twind_calibration.wiggling.joint_move import path
from twind_calibration.wiggling.state_trace import MoveHolds, StateTrace
from twind_drivers.virtual.servo_physics import DriveState

H24 = load_robot("h24")
WAY = 0.035  # rad, two degrees


def built(name: str, **changes: Any) -> RobotFile:
    """The h24 as somebody put it together: one joint otherwise than described."""
    joints = [replace(joint, **changes) if joint.name == name else joint for joint in H24.joints]
    return replace(H24, joints=tuple(joints))


class WholeBodyRig(Rig):
    """A daemon whose robot is moved by MuJoCo: one body for all its buses."""

    def _virtual(self, bus: str, start: Mapping[str, float]) -> Any:
        if not hasattr(self, "_body"):
            self._body = buses(self.made, now=self.clock.now())
        return self._body[bus]


class BodyRig(Rig):
    """A daemon whose robot is `true`, whatever its robot file says, moved by MuJoCo."""

    def __init__(self, true: RobotFile = H24, *, truth: RobotGroundTruth | None = None) -> None:
        self._true = true
        self._made_buses = {}
        super().__init__("h24", truth=truth)

    def _virtual(self, bus: str, start: Mapping[str, float]) -> Any:
        if not self._made_buses:
            # Zeros and registers as calibrated; the body may be another.
            self._made_buses = buses(replace(self.made, robot=self._true), now=self.clock.now())
        return self._made_buses[bus]

    def lay(self, base: str) -> None:
        """Somebody turns the whole robot, its torque on."""
        self.virtual["main"].servos.muscles.set_base_pose(base)
        self.seconds(0.5)

    def go(self, goals: Mapping[str, float], seconds: float) -> None:
        """Several joints to a pose, and rest there."""
        rows = self.loop.executor.reference.position.copy()[None]
        places = [self.names.index(name) for name in goals]
        rows[0, places] = list(goals.values())
        commanded = np.isin(np.arange(len(self.names)), places)
        ticket = self.submit(Trajectory(np.array([seconds]), rows, commanded, np.zeros_like(rows)), more=True)
        self.seconds(seconds + 0.5)
        assert self.replies(ticket)[0].error is None, self.replies(ticket)[0]

    def wiggled(self, name: str, way: float = WAY) -> MoveHolds:
        """Record of one joint that moves away and back."""
        place = self.names.index(name)
        home = float(self.loop.executor.reference.position[place])
        stays = self.traced(path(name, home, way)).stays(place, home, home + way)
        assert stays is not None
        return stays

    def traced(self, trajectory: Mapping[str, Any]) -> StateTrace:
        """Record of one joint that moves one way, with a little time before and after."""
        [name], points = trajectory["joint_names"], trajectory["points"]
        place = self.names.index(name)
        rows = np.tile(self.loop.executor.reference.position, (len(points), 1))
        rows[:, place] = [each["positions"][0] for each in points]
        time = np.array([each["time_from_start"] for each in points])
        commanded = np.arange(len(self.names)) == place
        trace = StateTrace(self.names)
        self.lease()
        self.record(trace, 0.2)
        ticket = self.submit(Trajectory(time, rows, commanded, np.zeros_like(rows)), more=True)
        self.record(trace, 0.1)
        if any(reply.error for reply in self.replies(ticket)):
            return trace
        self.record(trace, float(time[-1]) + 0.3)
        return trace

    def record(self, trace: StateTrace, seconds: float) -> None:
        """States as the front sends them, every second tick."""
        for _ in range(round(seconds / self.loop.robot.period / 2)):
            self.ticks(2)
            now = self.loop.robot.measured
            goal = self.loop.executor.reference.position
            rows = zip(
                self.names,
                now.position,
                now.effort,
                now.heard,
                goal,
                self.loop.robot.simulated.position,
                strict=True,
            )
            trace.take([
                {"name": name, "position": p, "effort": e, "heard": bool(h), "goal": g, "simulated": s}
                for name, p, e, h, g, s in rows
            ])  # fmt: skip


@contextmanager
def armed(true: RobotFile, pose: Mapping[str, float] | None = None) -> Iterator[BodyRig]:
    rig = BodyRig(true)
    try:
        rig.arm()
        if pose:
            rig.go(pose, 1.5)
        yield rig
    finally:
        rig.close()


# 0.5 kg at 0.2 m: 0.98 N·m when level. Two arms side by side, so that one can be on another bus.
ARMS = """<mujoco><compiler angle="radian"/><worldbody>
<body name="a" pos="0 0 1"><freejoint name="root"/><geom size=".01" mass="1"/>
<body><joint name="one" axis="0 1 0" damping="0.02" armature="0.01" frictionloss="{friction}"/>
<geom pos="0 0 -.2" size=".02" mass="0.5"/></body>
<body pos="0 .5 0"><joint name="two" axis="0 1 0" damping="0.02" armature="0.01" frictionloss="{friction}"/>
<geom pos="0 0 -.2" size=".02" mass="0.5"/></body></body></worldbody>
<actuator><position joint="one"/></actuator><sensor><actuatorfrc actuator="{actuator}"/></sensor></mujoco>"""


def power(
    muscles: MujocoPhysics | BusPhysics,
    p: float = 800,
    i: float = 0,
    on: bool = True,
    mode: int = 3,
    **caps: float,
) -> None:
    one = np.ones(len(muscles.position))
    muscles.drive(
        DriveState(
            on=one > 0 if on else one < 0,
            mode=np.full(one.size, mode),
            p=p * one,
            i=i * one,
            d=0 * one,
            velocity_p=100 * one,
            velocity_i=1920 * one,
            pwm_cap=caps.get("pwm", 885) * one,
            current_cap=caps.get("current", 1193) * one,
            supply=caps.get("supply", 1.0) * one,
        )
    )
