"""The measured robot in the model: pose, and the torque that the model needs to be there. No physics.

A pose is written and evaluated with `mj_inverse`, never `mj_forward`. Measured poses jump, which defeats the
solver, and a foot a millimetre inside the floor would cause forces that do not exist.
"""

import copy

import mujoco
import numpy as np

from twind.robot.arrays import Bools, Floats, Ints, every, some
from twind.robot.joint_state import JointState
from twind.twin.binding import Binding

# Values beyond these are no reading, and MuJoCo would use them all the same.
MAX_ANGLE = 1e3  # rad
MAX_SPEED = 1e4  # rad/s


class TwinMirror:
    """Mirror of the last believable reading of every joint; starts in the rest pose."""

    def __init__(self, binding: Binding) -> None:
        self.model = copy.copy(binding.model)  # its own copy: contacts and joint stops are off here
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        self.data = mujoco.MjData(self.model)
        self.refused = 0  # fresh readings that were not believable
        self._place = index(binding.qpos)
        self._speed = index(binding.dof)
        self._qpos = self.data.qpos
        self._qvel = self.data.qvel
        self._force = self.data.qfrc_inverse
        self._seen = np.zeros(len(binding.qpos), np.bool_)
        self._whole = False  # every joint has been read
        self._qpos[self._place] = binding.rest
        mujoco.mj_inverse(self.model, self.data)  # qacc is zero and stays zero

    @property
    def position(self) -> Floats:
        """Pose in the model (n,), rad. A copy."""
        return np.array(self._qpos[self._place])

    @property
    def effort(self) -> Floats:
        """Torque (n,), N·m, that keeps the measured pose at its speed; NaN for joints never read."""
        force = np.array(self._force[self._speed])
        if not self._whole:
            force[~self._seen] = np.nan
        return force

    def update(self, measured: JointState) -> None:
        """Take a reading. Joints that are not fresh, or not believable, keep their last."""
        position = measured.position
        velocity = measured.velocity
        fresh = believable(position, velocity)
        if not (every(fresh) and every(measured.heard)):
            self.refused += int(np.count_nonzero(measured.heard & ~fresh))
            fresh &= measured.heard
            if not some(fresh):
                return
            position = np.where(fresh, position, self._qpos[self._place])
            velocity = np.where(fresh, velocity, self._qvel[self._speed])
        if not self._whole:
            self._seen |= fresh
            self._whole = bool(self._seen.all())
        self._qpos[self._place] = position
        self._qvel[self._speed] = velocity
        mujoco.mj_inverse(self.model, self.data)


def believable(position: Floats, velocity: Floats) -> Bools:
    """Return (n,): both values have a size that a joint can have. NaN has not."""
    found: Bools = (np.abs(position) < MAX_ANGLE) & (np.abs(velocity) < MAX_SPEED)
    return found


def index(addresses: Ints) -> slice | Ints:
    """Return a slice where the addresses are consecutive: writing through it is twice as fast."""
    first = int(addresses[0])
    count = len(addresses)
    if np.array_equal(addresses, np.arange(first, first + count)):
        return slice(first, first + count)
    return addresses
