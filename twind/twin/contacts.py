"""Contacts of a simulated pose: the deepest one that keeps a joint from turning."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from twind.robot.arrays import Bools
from twind.twin.collision_model import body_name


@dataclass(frozen=True, slots=True)
class Contact:
    """Two bodies that touch."""

    bodies: tuple[str, str]  # names, that of the moved body first
    depth: float  # m, by which their surfaces overlap


def deepest_contact(model: Any, data: Any, dof: int, ignored: Collection[int]) -> Contact | None:
    """Return the deepest contact between a body that joint `dof` moves and one that it does not move.

    `dof`: address in qvel. `ignored`: geoms whose contacts are left out. None: there is no such contact.
    """
    if not data.ncon:
        return None
    moved = _moved(model, int(model.dof_bodyid[dof]))[model.geom_bodyid]
    geoms = np.array(data.contact.geom)
    depth = -np.array(data.contact.dist)
    between = (moved[geoms[:, 0]] != moved[geoms[:, 1]]) & ~np.isin(geoms, list(ignored)).any(axis=1)
    depth[~between] = 0.0
    place = int(np.argmax(depth))
    if not depth[place] > 0.0:
        return None
    one, other = sorted(geoms[place].tolist(), key=lambda geom: not moved[geom])
    return Contact((body_name(model, one), body_name(model, other)), float(depth[place]))


def _moved(model: Any, body: int) -> Bools:
    """Return bodies (nbody,) that move with `body`: it and its descendants.

    A parent has the smaller number.
    """
    moved: Bools = np.zeros(model.nbody, np.bool_)
    moved[body] = True
    for child in range(body + 1, model.nbody):
        moved[child] = moved[model.body_parentid[child]]
    return moved
