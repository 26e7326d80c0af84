"""A virtual servo that carries a mass on an arm, by its registers alone; under given times."""

from math import pi

import mujoco
import numpy as np

from twind.twin.mujoco_physics import MujocoPhysics, ServoMotor
from twind_drivers.virtual.virtual_servos import ServoSpec, VirtualServos

GRAVITY = 9.81
TICK = 2.0 * pi / 4096.0  # rad
ZERO = 2048  # count at the lowest place of the mass
MODEL = """<mujoco><compiler angle="radian"/><worldbody><body name="arm" pos="0 0 1"><freejoint/>
<geom size=".01" mass="1"/><body><joint name="hinge" axis="0 1 0"/>
<geom pos="0 0 -{length}" size=".003" mass="{mass}"/></body></body></worldbody></mujoco>"""


class Pendulum:
    """One servo with a mass of `mass` kg at `length` m. Angles are rad, 0 is the lowest place."""

    def __init__(self, model: str, mass: float, length: float, *, volts: float | None = None) -> None:
        spec = mujoco.MjSpec.from_string(MODEL.format(mass=mass, length=length))
        self.body = MujocoPhysics(spec, [ServoMotor("hinge", ZERO, 1.0 / TICK)], pinned=True)
        # What the vendor's limits forbid is not what is asked here.
        settings = {"shutdown": 0, "operating_mode": 3}
        self.servos = VirtualServos([ServoSpec(1, model, settings)], self.body.part([0]))
        self.now = 0.0
        if volts is not None:
            self.servos.supply(volts)

    @property
    def angle(self) -> float:
        return float(self.body.data.qpos[0])

    @property
    def speed(self) -> float:
        return float(self.body.data.qvel[0])

    def register(self, key: str, value: int) -> None:
        self.servos.registers.put(key, value, 0)
        self.servos.invalidate_cache()

    def torque(self, on: bool) -> None:
        self.servos.torque(0, on)
        self.servos.invalidate_cache()

    def goal(self, angle: float) -> None:
        self.servos.set_goals(np.array([round(ZERO + angle / TICK)]))

    def until(self, now: float) -> None:
        """Let time pass until `now`, s."""
        self.now = now
        self.servos.advance(now)

    def wait(self, seconds: float) -> None:
        self.until(self.now + seconds)
