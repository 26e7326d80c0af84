"""Survey of the simulated servos: joints that do not come to rest after a step, and values that settle them.

A light link without `armature` and `damping` has too little inertia for its stiff servo: the simulation
vibrates or breaks down, where the real gear does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from twind.robot.arrays import Floats
from twind.twin.binding import Binding
from twind.twin.simulation import Simulation, hush

STEP = 0.1  # rad, of each joint towards the middle of its range
PERIOD = 0.01  # s
WAIT = 1.0  # s until a joint should stand
LOOK = 0.3  # s after that
STILL = 0.002  # rad between the extremes while it stands; counts of a servo are 0.0015
ARMATURES = (0.003, 0.01, 0.03, 0.1)  # kg·m² that are tried; published ones of small servos are up to 0.045
RATIO = 1.0  # of critical damping that is added with them, as by the back-EMF of an XM430


@dataclass(frozen=True, slots=True)
class UnsettledJoint:
    """Joint that does not come to rest. `swing`: rad between extremes after `WAIT`; inf: it broke down."""

    name: str
    swing: float
    armature: float | None  # kg·m² and N·m·s/rad with which it stands; None: none of those that were tried
    damping: float

    @property
    def broken(self) -> bool:
        """True: the simulation breaks down."""
        return self.swing == np.inf

    def __str__(self) -> str:
        swing = "breaks down" if self.broken else f"vibrates by {self.swing:.3f} rad"
        text = f"simulation: {self.name} {swing} {WAIT:g} s after a step of {STEP:g} rad"
        if self.armature is None:
            return f"{text}: its `armature` and `damping` in the model are too small for its `kp`"
        values = f'armature="{self.armature:g}" damping="{self.damping:.2g}"'
        return f"{text}; it settles with {values} (use those of your servo)"


def survey_settling(binding: Binding) -> tuple[UnsettledJoint, ...]:
    """Step all joints at once, without contacts; return those that do not come to rest, worst first."""
    hush()
    swings = _swings(binding, (), 0.0)
    bad = [int(joint) for joint in np.argsort(-swings) if swings[joint] > STILL]
    if not bad:
        return ()
    armature = next(
        (value for value in ARMATURES if (_swings(binding, bad, value) <= STILL).all()),
        None,
    )
    return tuple(
        UnsettledJoint(
            binding.joint_map.names[joint],
            float(swings[joint]),
            armature,
            _damping(binding, joint, armature or 0.0),
        )
        for joint in bad
    )


def _damping(binding: Binding, joint: int, armature: float) -> float:
    """Return the damping (N·m·s/rad) that goes with an armature, for the stiffness of the joint's servo."""
    stiffness = float(binding.model.actuator_gainprm[binding.actuators[joint], 0])
    return 2.0 * RATIO * float(np.sqrt(stiffness * armature))


def _swings(binding: Binding, joints: Sequence[int], armature: float) -> Floats:
    """Return the swing (n,) of each joint, rad, with an armature and its damping added to `joints`."""
    simulation = Simulation(binding, PERIOD)
    model = simulation.model
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    if binding.floating:
        model.opt.gravity[:] = 0.0  # nothing carries it
    for joint in joints:
        dof = binding.dof[joint]
        model.dof_armature[dof] = armature
        model.dof_damping[dof] = _damping(binding, joint, armature)
    middle = 0.5 * (binding.limits.lower + binding.limits.upper)
    goal = binding.rest + np.clip(middle - binding.rest, -STEP, STEP)
    rows = []
    for tick in range(round((WAIT + LOOK) / PERIOD)):
        simulation.step(goal)
        if simulation.resets:
            return np.full(len(goal), np.inf)
        if tick * PERIOD >= WAIT:
            rows.append(np.array(simulation.data.qpos[binding.qpos]))
    places = np.array(rows)
    swings: Floats = places.max(axis=0) - places.min(axis=0)
    return swings
