"""URDF of a robot: its tree, inertias, limits, and the shapes of its model.

A capsule becomes a cylinder and two spheres, an ellipsoid the box around it. A mesh is named by `file://`
where every user may read the file, else it becomes a box too. Numbers have twelve digits.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import atan2, hypot
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from twind.observe.describing.robot_frames import FrameJoint, FramePose, RobotTree
from twind.robot.arrays import Floats

GEOM = mujoco.mjtGeom
SHOWN = 3  # groups below are shown, as in MuJoCo's viewer
MESHES = (".stl", ".obj", ".dae")  # that RViz reads
LOCK = 1e-8  # cosine of the pitch below which roll and yaw turn about one axis
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def urdf_text(tree: RobotTree, robot: Mapping[str, Any]) -> str:
    """Return the URDF; `robot`: the robot file in the form of `GetRobot`, whose limits the joints get."""
    root = Element("robot", name=str(robot["name"]))
    for name, body in tree.links.items():
        link = SubElement(root, "link", name=name)
        if body:
            _add_inertia(link, tree.model, body)
            _add_shapes(link, tree.model, body, Path(robot["mjcf_path"]).parent)
    limits = {joint["name"]: joint for joint in robot["joints"]}
    for joint in tree.joints:
        _add_joint(root, joint, tree.model, limits)
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _add_joint(root: Element, joint: FrameJoint, model: Any, limits: Mapping[str, Mapping[str, Any]]) -> None:
    element = SubElement(root, "joint", name=joint.name, type=joint.kind)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    _add_origin(element, joint.origin)
    if joint.kind == "fixed":
        return
    SubElement(element, "axis", xyz=_row(joint.axis))
    leader = limits[joint.leader]
    ends = sorted(joint.multiplier * leader[side] + joint.offset for side in ("lower", "upper"))
    speed = abs(joint.multiplier) * leader["velocity_limit"]
    limit = {"lower": _row(ends[:1]), "upper": _row(ends[1:]), "velocity": _row([speed])}
    SubElement(element, "limit", limit | {"effort": _row([_strength(model, leader["model_joint"])])})
    if joint.leader != joint.name:
        law = {"multiplier": _row([joint.multiplier]), "offset": _row([joint.offset])}
        SubElement(element, "mimic", {"joint": joint.leader, **law})


def _strength(model: Any, joint: str) -> float:
    """Return the force limit (N·m) of the actuator of a joint; 0: the model has none."""
    number = model.joint(joint).id
    drives = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == number)
    limited = drives & (model.actuator_forcelimited != 0)
    return float(model.actuator_forcerange[limited, 1].max(initial=0.0))


def _add_inertia(link: Element, model: Any, body: int) -> None:
    if model.body_mass[body] <= 0.0:
        return
    inertial = SubElement(link, "inertial")
    _add_origin(inertial, FramePose(model.body_ipos[body], model.body_iquat[body]))
    SubElement(inertial, "mass", value=_row([model.body_mass[body]]))
    ixx, iyy, izz = (_row([each]) for each in model.body_inertia[body])
    SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")


def _add_shapes(link: Element, model: Any, body: int, folder: Path) -> None:
    first = int(model.body_geomadr[body])
    for geom in range(first, first + int(model.body_geomnum[body])):
        place = FramePose(model.geom_pos[geom], model.geom_quat[geom])
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        uses = ["visual"] * int(model.geom_group[geom] < SHOWN) + ["collision"] * bool(touches)
        for offset, shape, sizes in _shapes(model, geom, folder):
            for use in uses:
                element = SubElement(link, use)
                _add_origin(element, place.then(offset))
                SubElement(SubElement(element, "geometry"), shape, sizes)
                if use == "visual":
                    _add_colour(element, model, geom)


def _shapes(model: Any, geom: int, folder: Path) -> Iterator[tuple[FramePose, str, dict[str, str]]]:
    """Shapes of URDF that show one geom: pose in the geom's frame, name, sizes."""
    kind = int(model.geom_type[geom])
    size = model.geom_size[geom]
    centre = FramePose(np.zeros(3), UPRIGHT)
    if kind == GEOM.mjGEOM_SPHERE:
        yield centre, "sphere", {"radius": _row(size[:1])}
    elif kind in (GEOM.mjGEOM_CYLINDER, GEOM.mjGEOM_CAPSULE):
        yield centre, "cylinder", {"radius": _row(size[:1]), "length": _row([2.0 * size[1]])}
        for end in (size[1], -size[1]) if kind == GEOM.mjGEOM_CAPSULE else ():
            yield FramePose(np.array([0.0, 0.0, end]), UPRIGHT), "sphere", {"radius": _row(size[:1])}
    elif kind in (GEOM.mjGEOM_BOX, GEOM.mjGEOM_ELLIPSOID):
        yield centre, "box", {"size": _row(2.0 * size)}
    elif kind == GEOM.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        file = _mesh_file(model, mesh, folder)
        if file is not None:
            place = FramePose(model.mesh_pos[mesh], model.mesh_quat[mesh]).inverse()
            yield place, "mesh", {"filename": file.as_uri(), "scale": _row(model.mesh_scale[mesh])}
        else:
            box = model.geom_aabb[geom]
            yield FramePose(box[:3], UPRIGHT), "box", {"size": _row(2.0 * box[3:])}


def _mesh_file(model: Any, mesh: int, folder: Path) -> Path | None:
    """Return the file of a mesh if RViz reads its format and every user may read the file."""
    begin = int(model.mesh_pathadr[mesh])
    if begin < 0:
        return None
    file = (folder / model.paths[begin:].split(b"\0", 1)[0].decode()).resolve()
    return file if file.suffix.lower() in MESHES and is_public(file) else None


def is_public(file: Path) -> bool:
    """Every user of this machine may read the file."""
    try:
        return file.stat().st_mode & 0o004 != 0 and all(each.stat().st_mode & 0o001 for each in file.parents)
    except OSError:
        return False


def _add_colour(visual: Element, model: Any, geom: int) -> None:
    number = int(model.geom_matid[geom])
    colour = model.mat_rgba[number] if number >= 0 else model.geom_rgba[geom]
    rgba = " ".join(f"{each:.3g}" for each in colour.tolist())
    SubElement(SubElement(visual, "material", name=f"rgba {rgba}"), "color", rgba=rgba)


def _add_origin(element: Element, pose: FramePose) -> None:
    SubElement(element, "origin", xyz=_row(pose.position), rpy=_row(roll_pitch_yaw(pose.rotation)))


def roll_pitch_yaw(rotation: Floats) -> tuple[float, float, float]:
    """Return the angles (rad) about the fixed axes x, y, z of a quaternion w x y z."""
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, rotation)
    turn = flat.reshape(3, 3)
    level = hypot(turn[0, 0], turn[1, 0])
    pitch = atan2(-turn[2, 0], level)
    if level < LOCK:
        return atan2(-turn[1, 2], turn[1, 1]), pitch, 0.0
    return atan2(turn[2, 1], turn[2, 2]), pitch, atan2(turn[1, 0], turn[0, 0])


def _row(values: Sequence[float] | Floats) -> str:
    return " ".join(f"{float(each) + 0.0:.12g}" for each in values)
