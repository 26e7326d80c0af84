"""A virtual robot in MuJoCo under a fake clock, its motions as samples, also with heavier links."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tests.support.body_rig import BodyRig
from tests.support.true_servos import true_servos
from twind import link
from twind.command_line.trajectory_files import load_motion
from twind.config.identified_spec import IdentifiedBody, IdentifiedJoint, IdentifiedModel, ParameterEstimate
from twind.config.robot_file import load_robot
from twind.gap.gap_replay import resample
from twind.gap.motion_samples import MotionSamples
from twind.identification.excitation import RATE, ExcitationBounds, excite
from twind.identification.identified_robot import DataOrigin, identify_robot
from twind.robot.arrays import Floats
from twind.robot.trajectory import Trajectory
from twind.twin.binding import Binding, bind
from twind.virtual.virtual_robot_spec import body_for, buses

PART = 25.0  # s of one trajectory, at most, as written
ROOM = 0.02  # rad to the limits: a spline passes its points a little
LONGEST = 120.0  # s of it, slowed down
PERIOD = 0.01  # s
FORWARD = {"shoulder_lift": -0.5, "elbow_flex": 0.5}
LIFTING = ("shoulder_lift", "elbow_flex", "wrist_flex")
UNKNOWN = "2026-11-29T04:00:00Z"


def heavier(binding: Binding, factor: float) -> IdentifiedModel:
    """Return an overlay in which all links have `factor` times their mass."""
    model = binding.model
    masses = {model.body(at).name: float(model.body_mass[at]) for at in range(1, model.nbody)}
    bodies = {
        name: IdentifiedBody(mass_kg=ParameterEstimate(factor * mass, 0.0, mass, 0.0))
        for name, mass in masses.items()
        if name and mass > 0.0
    }
    return IdentifiedModel(binding.robot.name, UNKNOWN, "test", "masses", 0.0, 0.0, {}, bodies)


class GapRig(BodyRig):
    """Its links are `factor` times as heavy as the model says; the daemon does not know."""

    def __init__(self, robot: str, factor: float = 1.0, **more: Any) -> None:
        self.factor = factor
        super().__init__(robot, **more)

    def _virtual(self, bus: str, start: Any) -> Any:
        made = self.__dict__.setdefault("_made_buses", {})
        if not made:
            overlay = heavier(bind(self.made.robot, None), self.factor)
            spec = replace(self.made, robot=replace(self.made.robot, identified=overlay))
            self.body = body_for(spec, now=self.clock.now())
            made.update(buses(self.made, physics=False, body=self.body, now=self.clock.now()))
        return made[bus]

    def excite(self, joints: Sequence[str], amplitude: float, shift: float = 0.0) -> None:
        """Move joints as `twindctl identify` does, at the same time."""
        limits = self.loop.robot.limits
        start = self.loop.executor.reference.position
        columns = {}
        for place, name in enumerate(joints):
            at = self.names.index(name)
            bounds = ExcitationBounds(
                float(limits.lower[at]) + ROOM,
                float(limits.upper[at]) - ROOM,
                float(limits.velocity[at]),
                float(limits.acceleration[at]),
            )
            columns[at] = excite(float(start[at]), bounds, amplitude, shift + place / len(joints))
        count = max(map(len, columns.values()))
        rows = np.tile(start, (count, 1))
        for at, column in columns.items():
            rows[:, at] = np.pad(column, (0, count - len(column)), mode="edge")
        velocity = np.gradient(rows, 1.0 / RATE, axis=0)
        velocity[-1] = 0.0
        commanded = np.isin(np.arange(len(self.names)), list(columns))
        length = round(PART * RATE)
        for first in range(0, count, length):
            part = slice(first, min(first + length, count))
            times = np.arange(1, part.stop - part.start + 1) / RATE
            speed = velocity[part].copy()
            speed[-1] = 0.0
            self.follow(Trajectory(times, rows[part], commanded, speed))

    def follow(self, path: Trajectory) -> None:
        """Run a path to its end."""
        self.lease()
        ticket = self.submit(path, more=True, policy="retime")
        for _ in range(round(LONGEST)):
            self.ticks(100)
            self.lease()
            if any(not reply.continues for reply in self.replies(ticket)):
                break
        assert self.replies(ticket)[-1].parameters.get("phase") == "succeeded", self.replies(ticket)[-1]

    def play(self, name: str) -> None:
        """Run a motion that comes with the robot to its end."""
        motion = load_motion(name, self.robot.motions)
        points = motion["points"]
        times = np.array([point["time_from_start"] for point in points], np.float64)
        columns = [self.names.index(joint) for joint in motion["joint_names"]]
        rows = np.tile(self.loop.executor.reference.position, (len(points), 1))
        rows[:, columns] = [point["positions"] for point in points]
        self.follow(Trajectory(times, rows, np.isin(np.arange(len(self.names)), columns), None))

    def known_servos(self) -> Binding:
        """Return the robot with the true servos of its body, the masses being those of its file."""
        columns = true_servos(self.body.model, self.robot)
        joints = {
            name: IdentifiedJoint(
                **{key: ParameterEstimate(float(each[at]), 0.0, 1.0, 0.0) for key, each in columns.items()}
            )
            for at, name in enumerate(self.names)
        }
        found = IdentifiedModel(self.robot.name, UNKNOWN, "test", "servos", 0.0, 0.0, joints, {})
        return bind(replace(self.robot, identified=found), None)

    def samples(self) -> MotionSamples:
        """Return what the daemon has published since the last call."""
        ticks = [news for news in self.news if isinstance(news, link.Tick)]
        self.news = [news for news in self.news if not isinstance(news, link.Tick)]
        columns: Mapping[str, Floats] = {
            name: np.array([np.frombuffer(getattr(tick, name)) for tick in ticks])
            for name in ("goal", "position", "velocity", "effort")
        }
        return MotionSamples(self.names, np.array([tick.time for tick in ticks]), **columns)


@dataclass(frozen=True)
class IdentifiedArm:
    """The arm koch before and after its identification, and a motion that took no part in it."""

    plain: Binding
    known: Binding
    same: MotionSamples  # of the arm that was identified
    heavier: MotionSamples  # of one with links half as heavy again


def identified_arm(joints: Sequence[str] = LIFTING) -> IdentifiedArm:
    """Excite joints that lift, identify them, and swing all that lift; half a minute for two joints."""
    robot = load_robot("koch")
    plain = bind(robot, None)
    rig = stretched_arm(1.0)
    for joint in joints:
        rig.excite([joint], 0.4)
    rig.excite(joints, 0.25)
    motion = resample(rig.samples(), PERIOD)
    same = _swinging(rig)
    heavier_one = _swinging(stretched_arm(1.5))
    origin = DataOrigin(UNKNOWN, "test", "virtual")
    found = identify_robot(
        plain, [motion], origin, lambda model: bind(replace(robot, identified=model), None), joints
    )
    return IdentifiedArm(plain, bind(replace(robot, identified=found.model), None), same, heavier_one)


def stretched_arm(factor: float) -> GapRig:
    """Return the arm koch, stretched forward, with links `factor` times as heavy as its model says."""
    rig = GapRig("koch", factor)
    rig.arm()
    rig.move_to(FORWARD, 2.5)
    rig.samples()
    return rig


def _swinging(rig: GapRig) -> MotionSamples:
    rig.excite(LIFTING, 0.2, 0.37)
    rig.close()
    return rig.samples()
