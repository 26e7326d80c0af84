"""Centre of mass and soles of a free-standing robot, turned as its IMU measures. For fall detection.

Contact is not measured: the lowest corner of a sole counts as the point on which the robot stands.
"""

import mujoco
import numpy as np

from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.safety.capture_point import SupportPoints
from twind.twin.binding import Binding
from twind.twin.mirror import index
from twind.twin.standing_feet import StandingFeet


class SupportGeometry:
    """Feet and masses of one robot; keeps its own data of the model."""

    def __init__(self, binding: Binding) -> None:
        """Raises InvalidInput: the base is held, or nothing in the model stands on the floor."""
        if not binding.floating:
            raise InvalidInput("the base of this model is held: detecting a fall needs `support: free`")
        self._data = mujoco.MjData(binding.model)
        feet = StandingFeet(binding, binding.model, self._data)
        if not feet.has_feet:
            raise InvalidInput("nothing in the model stands on the floor: give its feet colliding geoms")
        self._feet = feet
        self._place = index(binding.qpos)
        soles = feet.sole_corners()
        self._bodies = np.array([body for body, _ in soles])
        self._corners = np.array([corner for _, corner in soles])

    def place(self, position: Floats, quaternion: Floats) -> SupportPoints:
        """Return the points for joint angles (n,), rad, and the orientation w x y z (4,) of the base."""
        data = self._data
        data.qpos[self._place] = position
        self._feet.turn(quaternion)
        rotation = data.xmat[self._bodies].reshape(-1, 3, 3)
        corners = (rotation @ self._corners[:, :, None])[:, :, 0] + data.xpos[self._bodies]
        return SupportPoints(data.subtree_com[self._feet.base].copy(), corners)
