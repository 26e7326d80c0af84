"""Bound of how much closer two bodies can come when a joint turns: lever arms over all poses.

For a joint between two geoms no point of either moves, relative to the other, by more than lever x angle. The
lever is the farthest a point of the geom can be from the joint's axis. It runs from the axis to the next
joint's anchor, then along the anchors, whose distances no joint changes, then to the farthest point of the
geom.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from twind.robot.arrays import Floats, Ints


def levers(model: mujoco.MjModel, qpos: Ints, pairs: Sequence[tuple[int, int]]) -> Floats:
    """Return the lever (p, n), m, of each driven joint (by address in qpos) for each pair of geoms.

    0: not between.

    Joints that no motor drives count as rigid, as everywhere in the look-ahead.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    joints = {int(address): place for place, address in enumerate(qpos)}
    numbers = {int(model.jnt_qposadr[j]): j for j in range(model.njnt)}
    moved = {numbers[address]: place for address, place in joints.items()}
    arms = [_arms(model, data, geom, moved) for geom in range(model.ngeom)]
    found = np.zeros((len(pairs), len(joints)))
    for row, (a, b) in enumerate(pairs):
        for one, other in ((a, b), (b, a)):
            for place, arm in arms[one].items():
                if place not in arms[other]:
                    found[row, place] = arm
    return found


def _arms(model: mujoco.MjModel, data: mujoco.MjData, geom: int, moved: dict[int, int]) -> dict[int, float]:
    """Return the lever of each driven joint that moves a geom."""
    points, radius = _outline(model, data, geom)
    chain = _chain(model, int(model.geom_bodyid[geom]), moved)
    found: dict[int, float] = {}
    beyond = 0.0  # from the anchor of the joint after this one to the farthest point
    for at, joint in enumerate(chain):
        anchor = data.xanchor[joint]
        axis = data.xaxis[joint]
        if at == 0:
            found[moved[joint]] = radius + max(_off(points, anchor, axis))
            beyond = radius + float(np.linalg.norm(points - anchor, axis=1).max())
            continue
        after = data.xanchor[chain[at - 1]]
        found[moved[joint]] = max(_off(after[None], anchor, axis)) + beyond
        beyond += float(np.linalg.norm(after - anchor))
    return found


def _chain(model: mujoco.MjModel, body: int, moved: dict[int, int]) -> list[int]:
    """Return the driven joints that move a body, from the nearest to the root."""
    chain: list[int] = []
    while body:
        first = int(model.body_jntadr[body])
        count = int(model.body_jntnum[body])
        chain += [joint for joint in reversed(range(first, first + count)) if joint in moved]
        body = int(model.body_parentid[body])
    return chain


def _off(points: Floats, anchor: Floats, axis: Floats) -> Floats:
    """Return the distance of points (k, 3) from an axis."""
    away = points - anchor
    distance: Floats = np.linalg.norm(away - np.outer(away @ axis, axis), axis=1)
    return distance


def _outline(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[Floats, float]:
    """Return points (k, 3) in the world and a radius: all of the geom is within it of their hull."""
    kind = int(model.geom_type[geom])
    size = model.geom_size[geom]
    rotation = data.geom_xmat[geom].reshape(3, 3)
    centre = data.geom_xpos[geom]
    radius = 0.0
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        local = np.zeros((1, 3))
        radius = float(size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        local = np.array([[0.0, 0.0, size[1]], [0.0, 0.0, -size[1]]])
        radius = float(size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        local = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        local = np.array(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], np.float64)
    else:
        local = np.zeros((1, 3))
        radius = float(model.geom_rbound[geom])
    return centre + local @ rotation.T, radius
