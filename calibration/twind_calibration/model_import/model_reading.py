"""Import of one model file into a folder, in this process: `import_model.py` gives it one of its own."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from twind.exceptions import InvalidInput
from twind_calibration.model_import.imported_model import (
    HardwareSystem,
    ImportedJoint,
    ImportedModel,
    JointMimic,
    RemarkList,
    import_refused,
)
from twind_calibration.model_import.mesh_library import MeshLibrary
from twind_calibration.model_import.mjcf_reader import mjcf_elements, named_places, read_mjcf
from twind_calibration.model_import.model_finish import finish
from twind_calibration.model_import.model_writer import write_model
from twind_calibration.model_import.package_paths import PackagePaths
from twind_calibration.model_import.ros2_control_reader import read_hardware
from twind_calibration.model_import.urdf_checks import check_urdf
from twind_calibration.model_import.urdf_reader import read_urdf
from twind_calibration.model_import.xacro_expansion import expand_xacro, is_xacro
from twind_calibration.model_import.xml_tree import XmlElement, read_xml

KINDS: Mapping[int, Literal["hinge", "slide"]] = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
}
_LINE = re.compile(r"\bline (\d+)")
_NAMED = re.compile(r"name '([^']+)'")


@dataclass(frozen=True, slots=True)
class ModelSource:
    """Facts of a source file that MuJoCo does not keep."""

    name: str
    file: str
    places: Mapping[str, str]  # of joints by name
    velocities: Mapping[str, float]  # rad/s, limits of joints by name
    hardware: tuple[HardwareSystem, ...]


def read_model(
    path: Path,
    folder: Path,
    *,
    floating: bool | None,
    packages: Mapping[str, Path],
    arguments: Mapping[str, str],
    environment: Mapping[str, str],
) -> ImportedModel:
    """Import as `import_model` does. Raises InvalidInput, OSError: `folder` cannot be written."""
    remarks = RemarkList()
    paths = PackagePaths(path.parent, packages, environment)
    meshes = MeshLibrary(paths, remarks)
    root = read_xml(path)
    if is_xacro(root, path):
        root = expand_xacro(path, paths, arguments)
    elif arguments:
        raise import_refused(
            f"{', '.join(arguments)}: only a xacro file takes arguments; leave them out", where=str(path)
        )
    mujoco.set_mju_user_warning(
        lambda text: remarks.add(str(path), text)
    )  # else MuJoCo writes MUJOCO_LOG.TXT
    try:
        if root.tag == "robot":
            spec, source = _read_urdf(root, path, meshes, remarks)
        elif root.tag == "mujoco" and path.suffix != ".xacro":
            spec, source = _read_mjcf(root, path, meshes, remarks)
        else:
            known = "<robot> (URDF, xacro) and <mujoco> (MJCF)"
            raise root.refused(f"<{root.tag}> is not read; models are {known}")
        base = finish(spec, str(path), floating, remarks)
        file = write_model(spec, meshes, folder, source.name)
    except InvalidInput:
        raise
    except ValueError as error:
        text = " ".join(str(error).split())
        raise import_refused(f"MuJoCo: {text}; correct it", where=_where(text, root, path)) from None
    model = mujoco.MjModel.from_xml_path(str(file))
    return ImportedModel(
        name=source.name,
        file=file,
        base=base,
        floating=bool((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any()),
        mass=float(model.body_mass.sum()),
        joints=tuple(_joints(model, source, remarks)),
        hardware=source.hardware,
        remarks=tuple(remarks.entries),
    )


def _read_urdf(
    root: XmlElement, path: Path, meshes: MeshLibrary, remarks: RemarkList
) -> tuple[mujoco.MjSpec, ModelSource]:
    robot = check_urdf(root, remarks)
    limits = {name: joint.first("limit") for name, joint in robot.joints.items()}
    velocities = {name: limit.number("velocity", 0.0) for name, limit in limits.items() if limit is not None}
    places = {name: joint.place for name, joint in robot.joints.items()}
    hardware = read_hardware(root, remarks)
    source = ModelSource(_file_name(robot.name), str(path), places, velocities, hardware)
    return read_urdf(robot, meshes, remarks), source


def _read_mjcf(
    root: XmlElement, path: Path, meshes: MeshLibrary, remarks: RemarkList
) -> tuple[mujoco.MjSpec, ModelSource]:
    elements = mjcf_elements(root, path)
    name = _file_name(root.attributes.get("model") or path.stem)
    source = ModelSource(name, str(path), named_places(elements, "joint"), {}, ())
    return read_mjcf(path, elements, meshes, remarks), source


def _file_name(name: str) -> str:
    """Name of a robot as the name of a file."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)[:60]


def _where(message: str, root: XmlElement, path: Path) -> str:
    """Place that a message of MuJoCo is about."""
    line = _LINE.search(message)
    if line and root.tag == "mujoco":
        return f"{path}:{line[1]}"
    named = _NAMED.search(message)
    found = (e.place for e in root.walk() if named and e.attributes.get("name") == named[1])
    return next(found, str(path))


def _joints(model: mujoco.MjModel, source: ModelSource, remarks: RemarkList) -> Iterator[ImportedJoint]:
    """All joints with one axis."""
    followers = _mimics(model)
    for number in range(model.njnt):
        joint = model.joint(number)
        place = source.places.get(joint.name, source.file)
        kind = KINDS.get(int(model.jnt_type[number]))
        if kind is None:
            if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_BALL:
                remarks.add(
                    place, f"joint {joint.name!r} is a ball: it stays in the model, but no servo drives it"
                )
            continue
        lower, upper = model.jnt_range[number].tolist()
        x, y, z = model.jnt_axis[number].tolist()
        yield ImportedJoint(
            name=joint.name,
            kind=kind,
            body=model.body(int(model.jnt_bodyid[number])).name,
            axis=(x, y, z),
            range=(lower, upper) if model.jnt_limited[number] else None,
            velocity=source.velocities.get(joint.name) or None,
            effort=_effort(model, number),
            mimic=_resolved(joint.name, followers),
            place=place,
        )


def _effort(model: mujoco.MjModel, joint: int) -> float | None:
    """Smallest limit of the torque of a joint, N·m; None where there is none."""
    bounds = []
    if model.jnt_actfrclimited[joint]:
        bounds.append(np.abs(model.jnt_actfrcrange[joint]).max())
    driving = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == joint)
    for actuator in np.flatnonzero(driving & (model.actuator_forcelimited != 0)):
        gear = abs(float(model.actuator_gear[actuator, 0]))
        bounds.append(np.abs(model.actuator_forcerange[actuator]).max() * gear)
    return float(min(bounds)) if bounds else None


def _mimics(model: mujoco.MjModel) -> dict[str, JointMimic]:
    """Followers by name, as the constraints of the model couple them."""
    found = {}
    for row in np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT):
        leader = int(model.eq_obj2id[row])
        if leader >= 0:
            offset, multiplier = model.eq_data[row, :2].tolist()
            follower = model.joint(int(model.eq_obj1id[row])).name
            found[follower] = JointMimic(model.joint(leader).name, multiplier, offset)
    return found


def _resolved(name: str, followers: Mapping[str, JointMimic]) -> JointMimic | None:
    """Coupling of a joint to the one that moves freely, through all followers between them."""
    found = followers.get(name)
    for _ in followers:
        if found is None or found.joint not in followers:
            break
        above = followers[found.joint]
        offset = found.multiplier * above.offset + found.offset
        found = JointMimic(above.joint, found.multiplier * above.multiplier, offset)
    return found
