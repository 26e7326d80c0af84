"""A virtual servo that carries a mass on an arm, by its registers alone; under given times."""

from math import pi

import mujoco
import numpy as np

from twind.twin.mujoco_physics import MujocoPhysics, ServoMotor
from twind_drivers.feetech.virtual_feetech_servos import VirtualFeetechServos
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.virtual.virtual_servos import ServoSpec, VirtualServos

GRAVITY = 9.81
TICK = 2.0 * pi / 4096.0  # rad
ZERO = 2048  # count at the lowest place of the mass
MODEL = """<mujoco><compiler angle="radian"/><worldbody><body name="arm" pos="0 0 1"><freejoint/>
<geom size=".01" mass="1"/><body><joint name="hinge" axis="0 1 0"/>
<geom pos="0 0 -{length}" size=".003" mass="{mass}"/></body></body></worldbody></mujoco>"""


def body_of_pendulum(mass: float, length: float) -> MujocoPhysics:
    spec = mujoco.MjSpec.from_string(MODEL.format(mass=mass, length=length))
    return MujocoPhysics(spec, [ServoMotor("hinge", ZERO, 1.0 / TICK)], pinned=True)


class Pendulum:
    """One servo with a mass of `mass` kg at `length` m. Angles are rad, 0 is the lowest place."""

    def __init__(self, model: str, mass: float, length: float, *, volts: float | None = None) -> None:
        self.body = body_of_pendulum(mass, length)
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


class FeetechPendulum(Pendulum):
    """The same with a Feetech servo."""

    def __init__(self, model: str, mass: float, length: float, *, volts: float) -> None:
        self.body = body_of_pendulum(mass, length)
        servo = FeetechServoSpec(1, model, {"shutdown": 0, "overload_torque": 254}, volts=volts)
        self.feetech = VirtualFeetechServos([servo], self.body.part([0]))
        self.now = 0.0
        self.register("goal_velocity", 6000)

    def register(self, key: str, value: int) -> None:
        self.feetech.put(0, key, value)
        self.feetech.drive()

    def torque(self, on: bool) -> None:
        self.register("torque_enable", int(on))

    def goal(self, angle: float) -> None:
        self.register("goal_position", round(ZERO + angle / TICK))

    def until(self, now: float) -> None:
        self.now = now
        self.feetech.advance(now)
