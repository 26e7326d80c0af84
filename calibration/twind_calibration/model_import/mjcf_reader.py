"""Reading of an MJCF: MuJoCo reads and compiles it, then its meshes become hulls.

Masses are those that MuJoCo makes of the file as it is. A mesh that only shows a body which has a colliding
shape is dropped; so are textures and skins.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from twind.exceptions import InvalidInput
from twind_calibration.model_import.imported_model import RemarkList
from twind_calibration.model_import.mesh_library import MAX_FILE, MeshLibrary
from twind_calibration.model_import.urdf_checks import LARGEST_ANGLE
from twind_calibration.model_import.xml_tree import XmlElement, read_xml

MAX_INCLUDES = 100
FULL_TURN = 2.0 * np.pi  # rad; ranges written with numbers up to this are radians
FILES = ("mesh", "hfield", "texture", "skin")  # elements of `<asset>` and `<deformable>` that name a file


def mjcf_elements(root: XmlElement, path: Path) -> list[XmlElement]:
    """All elements of a file and of those that it includes. Raises InvalidInput."""
    found: list[XmlElement] = []
    waiting = [root]
    files = 0
    while waiting:
        for element in waiting.pop().walk():
            found.append(element)
            if element.tag == "include":
                files += 1
                if files > MAX_INCLUDES:
                    raise element.refused(
                        f"more than {MAX_INCLUDES} files are included; do they include themselves?"
                    )
                waiting.append(_included(element, path))
    _check_files(found, path)
    return found


def read_mjcf(
    path: Path, elements: list[XmlElement], meshes: MeshLibrary, remarks: RemarkList
) -> mujoco.MjSpec:
    """Spec of a file. Raises InvalidInput; ValueError: MuJoCo cannot read it."""
    spec = mujoco.MjSpec.from_file(str(path))
    model = spec.compile()
    _check_units(elements, model)
    fix_inertia(spec, model)
    for skin in list(spec.skins):
        remarks.add(str(path), f"skin {skin.name!r} was dropped")
        spec.delete(skin)
    _drop_textures(spec, path, remarks)
    _replace_meshes(spec, model, path, meshes, remarks)
    meshes.fill(spec)
    return spec


def fix_inertia(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Write into each body the mass and inertia that it was compiled with."""
    for body in spec.bodies[1:]:
        if model.body_mass[body.id] == 0.0:
            continue
        body.mass = model.body_mass[body.id]
        body.ipos = model.body_ipos[body.id]
        body.iquat = model.body_iquat[body.id]
        body.inertia = model.body_inertia[body.id]
        body.fullinertia = np.full(6, np.nan)
        body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.explicitinertial = True
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    spec.compiler.settotalmass = -1.0
    spec.compiler.balanceinertia = False
    spec.compiler.boundmass = 0.0
    spec.compiler.boundinertia = 0.0


def _included(element: XmlElement, path: Path) -> XmlElement:
    try:
        return read_xml(path.parent / element.required("file"))
    except InvalidInput as error:
        if error.where:
            raise
        raise element.refused(error.reason) from None


def _check_files(elements: list[XmlElement], path: Path) -> None:
    """Refuse files that are missing or too large, with their place."""
    compilers = [element.attributes for element in elements if element.tag == "compiler"]
    folders = {key: value for attributes in compilers for key, value in attributes.items()}
    for element in elements:
        name = element.attributes.get("file", "")
        if element.tag in FILES and name:
            own = "texturedir" if element.tag == "texture" else "meshdir"
            folder = folders.get(own, folders.get("assetdir", ""))
            if folders.get("strippath") == "true":
                name = Path(name).name
            file = path.parent / folder / name
            if not file.is_file():
                raise element.refused(f"{element.tag} {file}: No such file; correct the path or `{own}`")
            if file.stat().st_size > MAX_FILE:
                raise element.refused(f"{element.tag} {file}: larger than {MAX_FILE >> 20} MiB; decimate it")


def _check_units(elements: list[XmlElement], model: mujoco.MjModel) -> None:
    """Refuse ranges whose numbers fit the other unit. MuJoCo takes them as degrees by default."""
    given = any("angle" in element.attributes for element in elements if element.tag == "compiler")
    hinges = np.flatnonzero((model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & model.jnt_limited)
    if not len(hinges):
        return
    largest = int(hinges[np.abs(model.jnt_range[hinges]).max(axis=1).argmax()])
    low, high = model.jnt_range[largest]
    bound = max(-low, high)
    name = model.joint(largest).name
    place = next((e for e in elements if e.tag == "joint" and e.attributes.get("name") == name), elements[0])
    if bound > LARGEST_ANGLE:
        reason = f"range {low:g} {high:g} rad looks like degrees, at most ±{LARGEST_ANGLE:.4g} rad"
        raise place.refused(
            f'joint {name!r}: {reason}; write <compiler angle="degree"/>, or leave the range out'
        )
    if not given and np.degrees(bound) <= FULL_TURN:
        reason = (
            f"range {np.degrees(low):.4g} {np.degrees(high):.4g} is taken as degrees, but looks like radians"
        )
        raise place.refused(
            f'joint {name!r}: {reason}; write <compiler angle="radian"/>, or "degree" if it is so'
        )


def _drop_textures(spec: mujoco.MjSpec, path: Path, remarks: RemarkList) -> None:
    dropped = {texture.name for texture in spec.textures if texture.file or any(texture.cubefiles)}
    if not dropped:
        return
    remarks.add(str(path), f"{len(dropped)} textures from files were dropped")
    for material in spec.materials:
        material.textures = ["" if name in dropped else name for name in material.textures]
    for texture in list(spec.textures):
        if texture.name in dropped:
            spec.delete(texture)


def _replace_meshes(
    spec: mujoco.MjSpec, model: mujoco.MjModel, path: Path, meshes: MeshLibrary, remarks: RemarkList
) -> None:
    """Drop meshes that are only seen, make hulls of the others."""
    names: dict[str, str] = {}
    seen = []
    for geom in spec.geoms:
        if not geom.meshname:
            continue
        if model.geom_type[geom.id] != mujoco.mjtGeom.mjGEOM_MESH:  # a primitive that was fitted to a mesh
            geom.meshname = ""
            geom.size = model.geom_size[geom.id]
            geom.pos = model.geom_pos[geom.id]
            geom.quat = model.geom_quat[geom.id]
        elif _is_only_seen(geom, model):
            remarks.add(
                str(path),
                f"body {geom.parent.name or 'unnamed'!r}: meshes that collide with nothing were dropped",
            )
            seen.append(geom)
        elif geom.meshname not in names:
            vertices = mesh_vertices(model, model.mesh(geom.meshname).id)
            names[geom.meshname] = meshes.add_vertices(
                geom.meshname, vertices, repr(geom.meshname), str(path)
            )
    for geom in seen:  # last, since numbers of geoms change
        spec.delete(geom)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)
    for mesh in spec.meshes:
        mesh.name = names[mesh.name]
    for geom in spec.geoms:
        geom.meshname = names.get(geom.meshname, "")


def _is_only_seen(geom: Any, model: mujoco.MjModel) -> bool:
    """Check for a geom without collisions on a body that has a geom with collisions."""
    body = geom.parent
    colliding = [
        each for each in body.geoms if model.geom_contype[each.id] or model.geom_conaffinity[each.id]
    ]
    return geom not in colliding and bool(colliding) and not geom.name


def mesh_vertices(model: mujoco.MjModel, number: int) -> Any:
    """Vertices of a mesh in the frame of the geoms that use it, m."""
    start = int(model.mesh_vertadr[number])
    vertices = model.mesh_vert[start : start + int(model.mesh_vertnum[number])].astype(np.float64)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.mesh_quat[number])
    return vertices @ rotation.reshape(3, 3).T + model.mesh_pos[number]


def named_places(elements: Iterator[XmlElement] | list[XmlElement], tag: str) -> dict[str, str]:
    """Place of each named element with a tag."""
    return {e.attributes["name"]: e.place for e in elements if e.tag == tag and "name" in e.attributes}
