"""For the tests of clearance: robots, random ways, and a slow oracle that shares no code with the sweep.

The oracle samples a way densely, measures every pair with MuJoCo's own distance on the robot's own model, and
zooms in where the least of them is.
"""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from twind.config.robot_file import load_robot, read_robot
from twind.config.robot_spec import RobotFile
from twind.robot.arrays import Floats
from twind.robot.splines import Spline, interpolate
from twind.robot.trajectory import Reference, Trajectory
from twind.twin.binding import Binding, bind

SAMPLES = 400
ARM = """\
<mujoco><compiler angle="radian"/><worldbody>{world}
<body name="base" pos="0 0 0.3"><geom name="base" type="box" size="0.05 0.05 0.05" mass="1"/>
 <body name="upper"><joint name="shoulder" axis="0 1 0" range="-3 3"/>
  <geom name="upper" type="capsule" fromto="0.12 0 0 0.2 0 0" size="0.02" mass="0.1"/>
  <body name="middle" pos="0.2 0 0"><joint name="elbow" axis="0 1 0" range="-3 3"/>
   <geom name="middle" type="capsule" fromto="0.05 0 0 0.15 0 0" size="0.02" mass="0.1"/>
   <body name="tip" pos="0.2 0 0"><joint name="wrist" axis="0 1 0" range="-3 3"/>
    <geom name="tip" type="{tip}" size="0.03 0.03 0.03" mass="0.05"/></body></body></body></body>
</worldbody><actuator>
<position joint="shoulder" kp="9"/><position joint="elbow" kp="9"/><position joint="wrist" kp="9"/>
</actuator></mujoco>
"""
FILE = """\
format: twind-robot/1
name: arm
model: {{mjcf: arm.xml, base: base}}
support: {support}
buses: {{main: {{kind: dynamixel2}}}}
types: {{small: {{device: XM430-W350, gains: {{p: 1, i: 0, d: 0}}}}}}
defaults: {{type: small, bus: main}}
joints:
  shoulder: {{id: 1, limits_rad: [-2.9, 2.9]}}
  elbow: {{id: 2, limits_rad: [-2.9, 2.9]}}
  wrist: {{id: 3, limits_rad: [-2.9, 2.9]}}
poses: {{rest: {{}}}}
collision: {collision}
"""


def arm(
    folder: Path, collision: str = "{}", *, support: str = "gantry", world: str = "", tip: str = "sphere"
) -> Binding:
    """An arm of three joints in one plane that can reach its own base and, by `world`, more."""
    return bind(arm_file(folder, collision, support=support, world=world, tip=tip), None)


def arm_file(
    folder: Path, collision: str = "{}", *, support: str = "gantry", world: str = "", tip: str = "sphere"
) -> RobotFile:
    (folder / "arm.xml").write_text(ARM.format(world=world, tip=tip))
    (folder / "arm.yaml").write_text(FILE.format(support=support, collision=collision))
    return read_robot(folder / "arm.yaml")


def h24() -> Binding:
    return bind(load_robot("h24"), None)


def still(position: Floats) -> Reference:
    zero = np.zeros(len(position))
    return Reference(np.array(position, np.float64), zero, zero)


def line(*points: Floats | list[float], seconds: float = 1.0) -> Spline:
    """Straight from the first point through the others, one every `seconds`."""
    position = np.array(points, np.float64)
    time = np.arange(1, len(position)) * seconds
    path = Trajectory(time, position[1:], np.ones(position.shape[1], np.bool_))
    return interpolate(path, still(position[0]))


def wander(random: np.random.Generator, binding: Binding, share: float) -> Spline:
    """At most three joints through at most five points, of any degree, within `share` of the ranges."""
    n = len(binding.rest)
    k = int(random.integers(1, 6))
    joints = random.choice(n, int(random.integers(1, 4)), replace=False)
    commanded = np.isin(np.arange(n), joints)
    wide = share * (binding.limits.upper - binding.limits.lower)
    middle = binding.rest

    def draw(shape: tuple[int, ...]) -> Floats:
        drawn: Floats = (random.random(shape) - 0.5) * wide
        return drawn

    start = np.clip(middle + draw((n,)), binding.limits.lower, binding.limits.upper)
    position = np.clip(middle + draw((k, n)), binding.limits.lower, binding.limits.upper)
    time = np.cumsum(random.uniform(0.2, 1.5, k))
    degree = int(random.integers(3))
    velocity = 2.0 * draw((k, n)) if degree else None
    acceleration = 3.0 * draw((k, n)) if degree == 2 else None
    return interpolate(Trajectory(time, position, commanded, velocity, acceleration), still(start))


class Oracle:
    """The least distance of every pair along a way, by brute force."""

    def __init__(self, binding: Binding, pairs: list[tuple[int, int]]) -> None:
        self.binding = binding
        self.pairs = pairs
        self.data = mujoco.MjData(binding.model)

    def distance(self, position: Floats, pair: tuple[int, int]) -> float:
        self.data.qpos[self.binding.qpos] = position
        mujoco.mj_kinematics(self.binding.model, self.data)
        return float(mujoco.mj_geomDistance(self.binding.model, self.data, *pair, 1.0, None))

    def row(self, position: Floats) -> Floats:
        self.data.qpos[self.binding.qpos] = position
        mujoco.mj_kinematics(self.binding.model, self.data)
        model = self.binding.model
        data = self.data
        return np.array([mujoco.mj_geomDistance(model, data, a, b, 1.0, None) for a, b in self.pairs])

    def least(self, curve: Spline, samples: int = SAMPLES) -> Floats:
        """Least clearance of every pair (p,), m."""
        times = np.linspace(0.0, curve.duration, samples)
        rows = np.array([self.row(at(curve, t)) for t in times])
        least = rows.min(axis=0)
        step = times[1] - times[0]
        for place in np.flatnonzero(least < 0.03):
            middle = times[rows[:, place].argmin()]
            reach = step
            for _ in range(3):
                zoom = np.clip(np.linspace(middle - reach, middle + reach, 21), 0.0, curve.duration)
                found = [self.distance(at(curve, t), self.pairs[place]) for t in zoom]
                best = int(np.argmin(found))
                least[place] = min(least[place], found[best])
                middle = zoom[best]
                reach = reach / 8.0
        return least


def at(curve: Spline, t: float) -> Floats:
    reference = curve.sample(float(t))
    assert reference is not None
    return reference.position


def finished(steps: object, each: Callable[[], None] | None = None) -> object:
    """Return value of a generator that is run to its end."""
    while True:
        try:
            next(steps)  # type: ignore[call-overload]
            if each is not None:
                each()
        except StopIteration as stop:
            return stop.value


__all__ = ["Oracle", "arm", "arm_file", "at", "finished", "h24", "line", "still", "wander"]
