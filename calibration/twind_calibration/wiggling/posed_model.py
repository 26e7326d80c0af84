"""Model of a robot in a pose: loads, and the visible effect of a small move. No dynamics.

Frame of the words: x forward, y left, z up, as the model's base stands.
"""

import numpy as np

from twind.config.robot_spec import RobotFile
from twind.exceptions import InvalidInput
from twind.robot.arrays import Bools, Floats
from twind.robot.joint_state import JointState
from twind.twin.base_pose import UPRIGHT, gravity
from twind.twin.binding import bind
from twind.twin.mirror import TwinMirror

NEAR = 0.05  # m: what is moved less far from the axis than that is seen to turn, not to travel
WAYS = (("forward", "backward"), ("to its left", "to its right"), ("up", "down"))
SEEN = ("from the front", "from its left", "from above")


class PosedModel:
    """The twin's model of a robot, put into one pose after the other."""

    def __init__(self, robot: RobotFile, base: str = UPRIGHT) -> None:
        """`base`: how it is held (`base_pose.BASES`).

        Raises InvalidInput (also for a robot file without bodies), KeyError (no such base pose).
        """
        if robot.gate.collision.bodiless:
            raise InvalidInput(
                "the robot file describes no bodies (collision.bodies: none): it gives no loads"
            )
        binding = bind(robot, None)
        self.robot = robot
        self.free = binding.floating
        self.mjcf = binding.mjcf
        self._mirror = TwinMirror(binding)
        self._dof = binding.dof
        model = self._mirror.model
        self._joints = [int(model.dof_jntid[dof]) for dof in binding.dof]
        self.lie(base)

    def lie(self, base: str) -> None:
        """From now on the base is held so."""
        option = self._mirror.model.opt
        option.gravity[:] = gravity(base, option.gravity)
        self.base = base

    def torque(self, position: Floats) -> Floats:
        """N·m (n,) that holds this pose, no contact."""
        self._pose(position)
        return self._mirror.effort

    def flipped(self, position: Floats, joint: int) -> Floats:
        """Loads of all joints (N·m, (n,)) with a wrong sign of `joint`: position and torque are negated."""
        turned = position.copy()
        turned[joint] = -position[joint]
        found = self.torque(turned)
        found[joint] *= -1.0
        return found

    def exchanged(self, position: Floats, joint: int, other: int) -> Floats:
        """Loads of all joints (N·m, (n,)) if the servos of two joints were exchanged."""
        sign = self.robot.joints[joint].sign * self.robot.joints[other].sign
        swapped = position.copy()
        swapped[joint], swapped[other] = sign * position[other], sign * position[joint]
        found = self.torque(swapped)
        found[joint], found[other] = sign * found[other], sign * found[joint]
        return found

    def turned_round(self, position: Floats, joint: int) -> float:
        """Load of the joint itself (N·m) with a wrong sign."""
        return float(self.flipped(position, joint)[joint])

    def load_if_exchanged(self, position: Floats, joint: int, other: int) -> float:
        """Load of the joint (N·m) if its servo and that of joint `other` were exchanged."""
        return float(self.exchanged(position, joint, other)[joint])

    def twins(self, joint: int) -> list[int]:
        """Joints whose servo could be mistaken for this one's: same bus, same model, same gear."""
        own = self.robot.joints[joint]
        return [
            place
            for place, each in enumerate(self.robot.joints)
            if place != joint
            and not (each.transmission or own.transmission)
            and (each.bus, each.type.device, each.ratio) == (own.bus, own.type.device, own.ratio)
        ]

    def stands_on(self, joint: int) -> bool:
        """Return whether the ground carries part of the load, so that the joint's load is unknown."""
        return self.free and self.base == UPRIGHT and self.robot.joints[joint].name in self.robot.legs

    def looks_like(self, position: Floats, joint: int, way: float) -> str:
        """Describe the visible motion when the joint turns by `way` (rad): `l_foot moves backward`."""
        moved = position.copy()
        moved[joint] += way
        before = self._places(position)
        after = self._places(moved)
        model = self._mirror.model
        turned = int(model.jnt_bodyid[self._joints[joint]])
        carried = np.flatnonzero(self._carried(joint))
        if carried.size:  # of a model without geometry only the turn can be told
            travel = np.linalg.norm(after - before, axis=1)
            farthest = int(carried[travel[carried].argmax()])
            turned = int(model.geom_bodyid[farthest])
        body = model.body(turned).name or "what it carries"
        if carried.size and travel[farthest] >= NEAR * abs(way):
            return f"{body} moves {_way(after[farthest] - before[farthest])}"
        axis = np.array(self._mirror.data.xaxis[self._joints[joint]]) * np.sign(way)
        along = int(np.abs(axis).argmax())
        turn = "anti-clockwise" if axis[along] > 0.0 else "clockwise"
        return f"{body} turns {turn} seen {SEEN[along]}"

    def _carried(self, joint: int) -> Bools:
        """Mask (k,) of the geoms that the joint moves."""
        model = self._mirror.model
        own = {int(model.jnt_bodyid[self._joints[joint]])}
        for body in range(model.nbody):  # parents come first
            if int(model.body_parentid[body]) in own:
                own.add(body)
        return np.array([int(body) in own for body in model.geom_bodyid], np.bool_)

    def _places(self, position: Floats) -> Floats:
        self._pose(position)
        return np.array(self._mirror.data.geom_xpos)

    def _pose(self, position: Floats) -> None:
        count = len(position)
        nothing = np.zeros(count)
        heard = np.ones(count, np.bool_)
        self._mirror.update(JointState(0.0, position, nothing, nothing, nothing, heard))


def _way(travel: Floats) -> str:
    along = int(np.abs(travel).argmax())
    return WAYS[along][0 if travel[along] > 0.0 else 1]
