"""Balance of a free-standing robot (UNSTABLE_POSE): centre of mass above the feet.

The lowest foot stands flat. Quasi-static: the position of the mass counts, not its speed. Only `tipping` has
times and a path.
"""

from dataclasses import dataclass
from functools import cache
from math import nan
from typing import Any

import mujoco
import numpy as np

from twind.robot.arrays import Floats, Ints
from twind.robot.finding import Finding, ReasonCode
from twind.twin.binding import Binding
from twind.twin.mirror import index

INSIDE = 0.010  # m, the centre of mass from the edge of the feet
TOUCHING = 0.005  # m: a foot this near to the floor stands on it
ROUND = 16  # corners that represent the rim of a cylinder
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class Stance:
    """Stance of the robot: the bodies of the feet on the floor, the lowest first; empty: unknown."""

    feet: tuple[int, ...]
    margin: float  # m, from the centre of mass to the edge of what the feet span, < 0 outside; NaN unknown


@dataclass(frozen=True, slots=True)
class _FootGeometry:
    """A body that stands: corners (c, 3) in its frame, each with the radius (c,) of the rounding there."""

    body: int
    corners: Floats
    radius: Floats
    normal: Floats  # (3,), in its frame: up, when it is flat on the floor


class StandingFeet:
    """The feet of a robot: its lowest bodies when it stands upright in its rest pose.

    Writes the base's place in `data`, which its owner fills with the joints' angles.
    """

    def __init__(self, binding: Binding, model: Any, data: Any) -> None:
        self._model = model
        self._data = data
        base = model.body(binding.robot.base)
        self._base = int(base.id)
        self._address = int(base.jntadr[0])
        self._qpos = int(model.jnt_qposadr[self._address])
        data.qpos[index(binding.qpos)] = binding.rest
        self.turn(np.array([1.0, 0.0, 0.0, 0.0]))
        self._feet = self._lowest()

    @property
    def has_feet(self) -> bool:
        """True if the robot has feet to stand on."""
        return bool(self._feet)

    @property
    def base(self) -> int:
        """Body that carries the free joint."""
        return self._base

    def sole_corners(self) -> list[tuple[int, Floats]]:
        """Return each corner (3,) of a sole, m, in the frame of its body, and that body.

        The rounding of a corner is left out: a rounded foot counts as smaller than it is.
        """
        found = []
        for foot in self._feet:
            heights = foot.corners @ foot.normal - foot.radius
            low = foot.corners[heights <= heights.min() + TOUCHING]
            found += [(foot.body, corner) for corner in low]
        return found

    def soles(self) -> list[tuple[int, Floats]]:
        """Return for each foot its body and the middle (3,) of its sole, m, in that body's frame."""
        found = []
        for foot in self._feet:
            heights = foot.corners @ foot.normal - foot.radius
            low = heights <= heights.min() + TOUCHING
            middle = (foot.corners[low] - foot.radius[low, None] * foot.normal).mean(axis=0)
            found.append((foot.body, middle))
        return found

    def stand(self) -> Stance:
        """Put the lowest foot of the pose in `data` flat on the floor: the base is turned to match."""
        if not self._feet:
            return Stance((), nan)
        self.turn(np.array([1.0, 0.0, 0.0, 0.0]))
        if not np.isfinite(self._data.xpos).all():
            return Stance((), nan)
        corners = [self._corners(foot) for foot in self._feet]
        lowest, up, _ = max(
            (self._beneath(place, corners) for place in range(len(corners))), key=_nothing_below
        )
        heights = [each @ up - foot.radius for each, foot in zip(corners, self._feet, strict=True)]
        floor = heights[lowest].min()
        touching = [height <= floor + TOUCHING for height in heights]
        points = np.concatenate([each[low] for each, low in zip(corners, touching, strict=True)])
        order = sorted(range(len(self._feet)), key=lambda place: (place != lowest, place))
        feet = tuple(self._feet[place].body for place in order if touching[place].any())
        rotation = _onto(up)
        mass = rotation @ self._data.subtree_com[self._base]
        self.turn(_quaternion(rotation))
        return Stance(feet, inside((points @ rotation.T)[:, :2], mass[:2]))

    def _beneath(self, place: int, corners: list[Floats]) -> "tuple[int, Floats, float]":
        """Return the foot, up in the base's frame, and the height of the other feet above it (m).

        This foot stands flat.
        """
        foot = self._feet[place]
        up = self._data.xmat[foot.body].reshape(3, 3) @ foot.normal
        least = [(each @ up - other.radius).min() for each, other in zip(corners, self._feet, strict=True)]
        others = [height for other, height in enumerate(least) if other != place]
        return place, up, min(others, default=np.inf) - least[place]

    def turn(self, quaternion: Floats) -> None:
        """Put the base at the origin with this orientation, at rest.

        Bodies and centre of mass are updated.
        """
        self._data.qpos[self._qpos : self._qpos + 3] = 0.0
        self._data.qpos[self._qpos + 3 : self._qpos + 7] = quaternion
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)

    def _corners(self, foot: _FootGeometry) -> Floats:
        """Return the corners (c, 3) at their present position."""
        rotation = self._data.xmat[foot.body].reshape(3, 3)
        placed: Floats = foot.corners @ rotation.T + self._data.xpos[foot.body]
        return placed

    def _lowest(self) -> list[_FootGeometry]:
        """Return the bodies whose colliding shapes are lowest now."""
        model = self._model
        found: dict[int, list[tuple[Floats, float]]] = {}
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            collides = bool(model.geom_contype[geom] | model.geom_conaffinity[geom])
            shape = _shape(model, geom) if collides and model.body_rootid[body] == self._base else None
            if shape is not None:
                found.setdefault(body, []).append(shape)
        feet = [self._foot(body, shapes) for body, shapes in found.items()]
        heights = [float((self._corners(foot)[:, 2] - foot.radius).min()) for foot in feet]
        floor = min(heights, default=0.0)
        return [foot for foot, height in zip(feet, heights, strict=True) if height <= floor + TOUCHING]

    def _foot(self, body: int, shapes: list[tuple[Floats, float]]) -> _FootGeometry:
        corners = np.concatenate([corners for corners, _ in shapes])
        radius = np.concatenate([np.full(len(corners), radius) for corners, radius in shapes])
        normal = self._data.xmat[body].reshape(3, 3).T @ UP
        return _FootGeometry(body, corners, radius, normal)


def tipping(time: Floats, margin: Floats, *, known: bool) -> list[Finding]:
    """Return UNSTABLE_POSE for the margins (k,) in m at `time` (k,) in s: at most one warning."""
    if not known:
        reason = "balance cannot be judged: the model has nothing that stands on the floor"
        return [Finding(ReasonCode.UNSTABLE_POSE, message=reason)]
    near = np.flatnonzero(~(margin >= INSIDE))
    if not len(near):
        return []
    worst = int(np.where(np.isnan(margin), -np.inf, margin).argmin())
    reason = f"centre of mass inside the edge of the feet (m), least at {time[worst]:.3g} s"
    return [
        Finding(
            ReasonCode.UNSTABLE_POSE,
            time=float(time[near[0]]),
            value=float(margin[worst]),
            bound=INSIDE,
            message=reason,
        )
    ]


def inside(points: Floats, place: Floats) -> float:
    """Return how far `place` (2,) lies inside the hull of `points` (p, 2), m.

    Not positive outside, and on a line.

    Outside the size is at most the true distance.
    """
    if not (np.isfinite(points).all() and np.isfinite(place).all()):
        return nan
    one, other = _pairs(len(points))
    along = points[other] - points[one]
    length = np.hypot(along[:, 0], along[:, 1])
    apart = length > 1e-9
    if not apart.any():
        return -float(np.hypot(*(points.mean(axis=0) - place)))
    normal = np.stack([along[apart, 1], -along[apart, 0]], axis=1) / length[apart, None]
    normal = np.concatenate([normal, -normal])
    return float(((points @ normal.T).max(axis=0) - normal @ place).min())


@cache
def _pairs(count: int) -> tuple[Ints, Ints]:
    """Return the places of all pairs among `count`; not to be changed."""
    one, other = np.triu_indices(count, 1)
    return one, other


def _nothing_below(found: tuple[int, Floats, float]) -> float:
    return found[2]


def _onto(up: Floats) -> Floats:
    """Return the rotation (3, 3) that turns `up` onto the vertical."""
    axis = np.cross(up, UP)
    cosine = float(up @ UP)
    if cosine < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    skew = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    rotation: Floats = np.eye(3) + skew + skew @ skew / (1.0 + cosine)
    return rotation


def _quaternion(rotation: Floats) -> Floats:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    return quaternion


def _shape(model: Any, geom: int) -> tuple[Floats, float] | None:
    """Return corners (c, 3) in the body's frame and the radius around them; None: no shape that can stand."""
    size = model.geom_size[geom]
    kind = model.geom_type[geom]
    kinds = mujoco.mjtGeom
    radius = 0.0
    if kind == kinds.mjGEOM_BOX:
        corners = size * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    elif kind == kinds.mjGEOM_SPHERE:
        corners = np.zeros((1, 3))
        radius = float(size[0])
    elif kind == kinds.mjGEOM_CAPSULE:
        corners = np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]])
        radius = float(size[0])
    elif kind == kinds.mjGEOM_CYLINDER:
        turn = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)
        rim = [np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1) * size[0] for _ in range(2)]
        corners = np.concatenate([rim[0] - size[1] * UP, rim[1] + size[1] * UP])
    elif kind == kinds.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        corners = np.array(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], np.float64)
    else:
        return None
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return corners @ rotation.reshape(3, 3).T + model.geom_pos[geom], radius
