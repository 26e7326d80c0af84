"""The measured robot in the model: pose, and the torque that the model needs to be there. No physics.

A pose is written and evaluated with `mj_inverse`, never `mj_forward`. Measured poses jump, which defeats the
solver, and a foot a millimetre inside the floor would cause forces that do not exist. The model is evaluated
when a result is read: a tick only writes the pose.
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
        self._data = mujoco.MjData(self.model)
        self.refused = 0  # fresh readings that were not believable
        self._place = index(binding.qpos)
        self._speed = index(binding.dof)
        self._qpos = self._data.qpos
        self._qvel = self._data.qvel
        self._seen = np.zeros(len(binding.qpos), np.bool_)
        self._whole = False  # every joint has been read
        self._qpos[self._place] = binding.rest
        self._evaluated = False  # the results in `_data` are of the present pose

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's data of the present pose, evaluated."""
        if not self._evaluated:
            mujoco.mj_inverse(self.model, self._data)  # qacc is zero and stays zero
            self._evaluated = True
        return self._data

    @property
    def position(self) -> Floats:
        """Pose in the model (n,), rad. A copy."""
        return np.array(self._qpos[self._place])

    @property
    def effort(self) -> Floats:
        """Torque (n,), N·m, that keeps the measured pose at its speed; NaN for joints never read."""
        force: Floats = np.array(self.data.qfrc_inverse[self._speed])
        if not self._whole:
            force[~self._seen] = np.nan
        return force

    def update(self, measured: JointState) -> None:
        """Take a reading. Joints that are not fresh, or not believable, keep their last."""
        position = measured.position
        velocity = measured.velocity
        believed = believable(position, velocity)
        if not (self._whole and every(believed) and every(measured.heard)):
            fresh = believed & measured.heard
            self.refused += int(np.count_nonzero(measured.heard & ~believed))
            if not some(fresh):
                return
            position = np.where(fresh, position, self._qpos[self._place])
            velocity = np.where(fresh, velocity, self._qvel[self._speed])
            self._seen |= fresh
            self._whole = every(self._seen)
        self._qpos[self._place] = position
        self._qvel[self._speed] = velocity
        self._evaluated = False


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
