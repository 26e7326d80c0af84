"""Distances of the robot's bodies in a pose: kinematics and collision on a model copy of its own.

The judged pairs are chosen once, from the model's own filters and the robot file. Distances are between
surfaces, negative inside each other, exact up to `CollisionModel.reach` and never overstated. Contacts are
exact with multi-point contacts off, except for two boxes, which are measured one by one. It has no path
and no time.
"""

import copy
import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np

from twind.config.collision_config import Clearance
from twind.config.robot_spec import GateSettings
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats, Ints
from twind.robot.finding import ReasonCode
from twind.twin.lever_bounds import levers
from twind.twin.mirror import index

REACH = 0.03  # m: range of the measurement; farther pairs count as this far
WORLD = 0  # the body of all fixed geoms
_UNMEASURED = (int(mujoco.mjtGeom.mjGEOM_HFIELD), int(mujoco.mjtGeom.mjGEOM_SDF))


class CollisionSettings(Protocol):
    """Part of a robot file that the collision model needs."""

    @property
    def path(self) -> Path:
        """Path of the robot file, for messages."""

    @property
    def base(self) -> str:
        """Name of the body that carries all others."""

    @property
    def gate(self) -> GateSettings:
        """Settings that state which bodies are judged, and how near they may come."""


class JointBinding(Protocol):
    """Part of a binding that the collision model needs; a viewer only draws and has no complete binding."""

    @property
    def robot(self) -> CollisionSettings:
        """Collision settings of the robot file."""

    @property
    def model(self) -> Any:
        """mujoco.MjModel."""

    @property
    def qpos(self) -> Ints:
        """Address of each joint in qpos (n,)."""


@dataclass(frozen=True, slots=True)
class GeomPair:
    """Two geoms whose distance is judged."""

    geoms: tuple[int, int]  # by number; the smaller first
    bodies: tuple[str, str]  # names, for people
    code: ReasonCode  # reason code when they come too close
    block: float  # m

    @property
    def name(self) -> str:
        """Name of the pair, as messages contain it."""
        return " and ".join(self.bodies)


class CollisionModel:
    """The robot's bodies. Poses are (n,) rad in joint order; distances (p,) m in the order of `pairs`."""

    def __init__(self, binding: JointBinding, reach: float = REACH) -> None:
        """`reach`: m. Raises InvalidInput: a name that the model lacks, a pair that cannot be judged."""
        clearance = binding.robot.gate.collision
        model = binding.model
        self.pairs = judged(model, binding.robot)
        self.band = clearance.band
        self.block = np.array([pair.block for pair in self.pairs])
        self.levers = levers(model, binding.qpos, [pair.geoms for pair in self.pairs])
        self._ignored = None if clearance.judge_world else strangers(model, binding.robot.base)
        self._place = index(binding.qpos)
        boxes = [place for place, pair in enumerate(self.pairs) if _boxes(model, pair.geoms)]
        self.boxes = np.array(boxes, np.int64)  # pairs that `distances` does not measure: see `between`
        self._contact = np.full((model.ngeom, model.ngeom), -1)
        for place, pair in enumerate(self.pairs):
            if place not in boxes:
                a, b = pair.geoms
                self._contact[a, b] = self._contact[b, a] = place
        self._prepare(model, reach)

    def reaching(self, reach: float) -> "CollisionModel":
        """Return a model of the same bodies that measures distances up to `reach`, m."""
        other = copy.copy(self)
        other._prepare(self.model, reach)
        return other

    def _prepare(self, model: mujoco.MjModel, reach: float) -> None:
        """Copy the model. Set margins that make near pairs contacts; disable geoms that are never judged."""
        self.model = model = copy.copy(model)
        self.reach = reach = max(reach, float(self.block.max(initial=0.0)) + 2.0 * self.band)
        # of a pair they are summed up
        model.geom_margin[:] = 0.5 * reach
        model.geom_gap[:] = 0.0
        model.pair_margin[:] = reach
        model.pair_gap[:] = 0.0
        for geom in self._ignored or ():
            model.geom_contype[geom] = model.geom_conaffinity[geom] = 0
        _measure_exactly(model.opt)
        mujoco.mj_setConst(model, mujoco.MjData(model))  # else margins count for single-geom bodies only
        self.data = mujoco.MjData(model)
        self._qpos = self.data.qpos
        self._overflow = self.data.warning[mujoco.mjtWarning.mjWARN_CONTACTFULL]

    def place(self, position: Floats) -> None:
        """Set the pose (n,), rad."""
        self._qpos[self._place] = position
        mujoco.mj_kinematics(self.model, self.data)

    def distances(self, positions: Floats, boxes: Ints | None = None, most: float = REACH) -> Floats:
        """Return distances (k, p), m, in the poses (k, n), at most `reach`.

        Of two boxes only the pairs `boxes` are measured, at most `most`; the others are left at `reach`.
        Where the model's memory holds fewer contacts than there are, every pair counts as deep in the other.
        """
        measured = [] if boxes is None else boxes.tolist()
        model = self.model
        data = self.data
        place = self._place
        qpos = self._qpos
        found = np.full((len(positions), len(self.pairs)), self.reach)
        rows = []
        geoms = []
        gaps = []
        for row, position in enumerate(positions):
            qpos[place] = position
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            if data.ncon:
                contact = data.contact
                rows.append(row)
                geoms.append(contact.geom.copy())  # views: the next pose writes over them
                gaps.append(contact.dist.copy())
                if self._overflow.number:
                    self._overflow.number = 0
                    found[row] = -self.reach
            for pair in measured:
                found[row, pair] = self.between(pair, most)
        if rows:
            row_of = np.repeat(rows, [len(each) for each in gaps])
            pair = np.concatenate(geoms)
            gap = np.concatenate(gaps)
            column = self._contact[pair[:, 0], pair[:, 1]]
            known = column >= 0
            np.minimum.at(found, (row_of[known], column[known]), gap[known])
        return found

    def between(self, place: int, most: float) -> float:
        """Return the distance (m) of one pair in the pose set last, at most `most`."""
        a, b = self.pairs[place].geoms
        return float(mujoco.mj_geomDistance(self.model, self.data, a, b, most, None))


def _measure_exactly(option: Any) -> None:
    """Undo what a model asks of its simulation alone: contacts off, margins overridden, a coarse search.

    With any of these, bodies that touch are measured as far apart.
    """
    kept = option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)  # chooses the pairs
    option.disableflags = kept | int(mujoco.mjtDisableBit.mjDSBL_MULTICCD)
    option.enableflags = 0
    usual = mujoco.MjSpec().option
    option.ccd_iterations = max(option.ccd_iterations, usual.ccd_iterations)
    option.ccd_tolerance = min(option.ccd_tolerance, usual.ccd_tolerance)


# ------------------------------------------------------------------------------------------ which pairs


def judged(model: mujoco.MjModel, robot: CollisionSettings) -> tuple[GeomPair, ...]:
    """Return the pairs that are judged. Raises InvalidInput where the robot file names a missing body."""
    clearance = robot.gate.collision
    where = f"{robot.path}: collision"
    world = strangers(model, robot.base)
    pairs = [pair for pair in candidates(model) if clearance.judge_world or not world & set(pair)]
    allowed = _geom_pair_names(model, clearance.allow, f"{where}.allow")
    pairs = [pair for pair in pairs if not any(named(pair) for named in allowed)]
    if clearance.pairs is not None:
        only = _geom_pair_names(model, clearance.pairs, f"{where}.pairs")
        for names, named in zip(clearance.pairs, only, strict=True):
            if not any(named(pair) for pair in pairs):
                message = f"the model never lets [{', '.join(names)}] collide, or `allow` does"
                raise InvalidInput(f"{where}.pairs: {message}")
        pairs = [pair for pair in pairs if any(named(pair) for named in only)]
    return tuple(_pair(model, pair, world, clearance, where) for pair in pairs)


def strangers(model: mujoco.MjModel, base: str) -> frozenset[int]:
    """Return geoms that do not belong to the robot: floor, walls, things."""
    own = model.body_rootid[model.body(base).id]
    return frozenset(np.flatnonzero(model.body_rootid[model.geom_bodyid] != own).tolist())


def candidates(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Return pairs of geoms that the model lets collide: the smaller number first."""
    listed = {tuple(sorted(pair)) for pair in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    return [
        (a, b)
        for a in range(model.ngeom)
        for b in range(a + 1, model.ngeom)
        if (a, b) in listed or _collides(model, a, b)
    ]


def _collides(model: mujoco.MjModel, a: int, b: int) -> bool:
    """Apply MuJoCo's own filters: masks, excluded bodies, a body and its parent (computation chapter)."""
    if not (
        model.geom_contype[a] & model.geom_conaffinity[b] or model.geom_contype[b] & model.geom_conaffinity[a]
    ):
        return False
    one = int(model.geom_bodyid[a])
    other = int(model.geom_bodyid[b])
    low = min(one, other)
    high = max(one, other)
    if (low << 16) + high in model.exclude_signature:
        return False
    first = int(model.body_weldid[one])
    second = int(model.body_weldid[other])
    if first == second:
        return False
    above = [int(model.body_weldid[model.body_parentid[weld]]) for weld in (first, second)]
    related = first == above[1] or second == above[0]
    ignored = bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    return ignored or WORLD in (first, second) or not related


def _boxes(model: mujoco.MjModel, pair: tuple[int, int]) -> bool:
    """Check for two boxes, whose contacts do not give the distance.

    They are up to 14 mm off and 12 % are missed (measured).
    """
    return all(model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX for geom in pair)


def _pair(
    model: mujoco.MjModel, pair: tuple[int, int], world: frozenset[int], clearance: Clearance, where: str
) -> GeomPair:
    names = tuple(body_name(model, geom) for geom in pair)
    if any(int(model.geom_type[geom]) in _UNMEASURED for geom in pair):
        raise InvalidInput(f"{where}: [{', '.join(names)}]: a height field or SDF cannot be judged; allow it")
    if not world & set(pair):
        return GeomPair(pair, (names[0], names[1]), ReasonCode.SELF_COLLISION, clearance.block)
    ground = any(g in world and model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE for g in pair)
    return GeomPair(
        pair, (names[0], names[1]), ReasonCode.FLOOR if ground else ReasonCode.KEEP_OUT, clearance.world
    )


def body_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom's body; for a geom of the world, of the geom itself."""
    body = int(model.geom_bodyid[geom])
    if body == WORLD:
        return model.geom(geom).name or f"geom {geom} of the world"
    return model.body(body).name or f"body {body}"


@dataclass(frozen=True, slots=True)
class _GeomPairNames:
    """One pair of names as the geoms of either name."""

    one: frozenset[int]
    other: frozenset[int]

    def __call__(self, pair: tuple[int, int]) -> bool:
        a, b = pair
        return (a in self.one and b in self.other) or (b in self.one and a in self.other)


def _geom_pair_names(
    model: mujoco.MjModel, pairs: Iterable[Sequence[str]], where: str
) -> list[_GeomPairNames]:
    return [_GeomPairNames(_geoms(model, one, where), _geoms(model, other, where)) for one, other in pairs]


def _geoms(model: mujoco.MjModel, name: str, where: str) -> frozenset[int]:
    """Return the geom and the geoms of the body of that name. Raises InvalidInput with the nearest name."""
    geoms = {g for g in range(model.ngeom) if model.geom(g).name == name}
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if body >= 0:
        geoms |= {int(g) for g in np.flatnonzero(model.geom_bodyid == body)}
    elif not geoms:
        known = [model.body(b).name for b in range(model.nbody)]
        known += [model.geom(g).name for g in range(model.ngeom)]
        near = difflib.get_close_matches(name, list(filter(None, known)), 1)
        hint = f"; nearest: {near[0]}" if near else ""
        raise InvalidInput(f"{where}: the model has no body and no geom {name!r}{hint}")
    return frozenset(geoms)
