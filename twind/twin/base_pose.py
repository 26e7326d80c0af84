"""Pose of a held base, and the direction of gravity in its frame.

Frame: x forward, y left, z up, as the base stands in the model. No sensor measures it: the operator who lays
the robot down names the pose.
"""

from collections.abc import Mapping

import mujoco
import numpy as np

from twind.robot.arrays import Floats

UPRIGHT = "upright"
# Direction of gravity: on its back the front of the robot points up.
BASES: Mapping[str, tuple[float, float, float]] = {
    UPRIGHT: (0.0, 0.0, -1.0),
    "back": (-1.0, 0.0, 0.0),
    "front": (1.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0),
    "right": (0.0, -1.0, 0.0),
}


def gravity(base: str, upright: Floats) -> Floats:
    """Return gravity (3,), m/s², for that pose; `upright`: that of the model.

    Raises KeyError for another pose.
    """
    return np.array(BASES[base]) * float(np.linalg.norm(upright))


def lay_down(spec: mujoco.MjSpec, base: str, pose: Mapping[str, float]) -> None:
    """Turn gravity in a model with a pinned base, and put a bench under the lowest part in `pose`.

    `pose`: rad by model joint. Raises KeyError for another base pose.
    """
    spec.option.gravity = gravity(base, np.array(spec.option.gravity))
    if base == UPRIGHT:
        return
    down = np.array(BASES[base])
    bench = spec.worldbody.add_geom(name="bench", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2.0, 2.0, 0.1])
    mujoco.mju_quatZ2Vec(bench.quat, -down)
    bench.pos = down * _lowest(spec, down, pose)


def stand(model: mujoco.MjModel, data: mujoco.MjData, base: str) -> None:
    """Lower or lift a free `base` until the lowest part of the robot touches the floor, if there is one."""
    height = int(model.jnt_qposadr[model.body_jntadr[model.body(base).id]]) + 2
    touch_down(model, data, height, touching(model))


def touching(model: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """Return geoms: the floors, and those of the robot that can stand on one."""
    plane = int(mujoco.mjtGeom.mjGEOM_PLANE)
    still = model.geom_bodyid == 0
    touches = model.geom_contype != 0
    floors = np.flatnonzero(still & (model.geom_type == plane)).tolist()
    return floors, np.flatnonzero(~still & touches).tolist()


def touch_down(
    model: mujoco.MjModel, data: mujoco.MjData, height: int, geoms: tuple[list[int], list[int]]
) -> None:
    """Do what `stand` does, for frequent calls: `height` is the index of the base's height in qpos."""
    mujoco.mj_kinematics(model, data)
    floors, solid = geoms
    if floors and solid:
        distance = mujoco.mj_geomDistance
        floor = floors[0]
        data.qpos[height] -= min([distance(model, data, floor, geom, 10.0, None) for geom in solid])


def _lowest(spec: mujoco.MjSpec, down: Floats, pose: Mapping[str, float]) -> float:
    """Return how far down (m) the shapes reach that can touch something."""
    model = spec.compile()
    data = mujoco.MjData(model)
    for name, angle in pose.items():
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    touches = (model.geom_contype > 0) & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)
    turned = data.geom_xmat.reshape(-1, 3, 3)
    centre = data.geom_xpos + np.einsum("gij,gj->gi", turned, model.geom_aabb[:, :3])
    half = np.einsum("gij,i->gj", turned, down)  # down, in the frame of each geom
    reach = centre @ down + (np.abs(half) * model.geom_aabb[:, 3:]).sum(axis=1)
    return float(reach[touches].max(initial=0.0))
