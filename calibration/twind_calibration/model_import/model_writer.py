"""Writing of a compiled spec as MJCF: MuJoCo's own text, with exact numbers and meshes as files.

MuJoCo prints six digits. Poses, axes and masses are written again with all of theirs.
"""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from twind_calibration.model_import.imported_model import import_refused
from twind_calibration.model_import.mesh_library import FOLDER, MeshLibrary

PRINTED = 1e-4  # relative error of a number that MuJoCo printed
INLINE = ("vertex", "face", "normal", "texcoord", "builtin", "params", "refpos", "refquat", "scale")
IDENTITY = (1.0, 0.0, 0.0, 0.0)
ZERO = (0.0, 0.0, 0.0)


def write_model(spec: mujoco.MjSpec, meshes: MeshLibrary, folder: Path, name: str) -> Path:
    """Write `folder/name.xml` and its meshes; return the path. Raises InvalidInput, OSError."""
    file = folder / f"{name}.xml"
    if file.exists():
        raise import_refused("the file exists; name another folder or remove it", where=str(file))
    spec.modelname = name
    spec.compiler.meshdir = FOLDER
    model = spec.compile()
    root = ElementTree.fromstring(spec.to_xml())
    _write_exactly(root, model)
    compiler = root.find("compiler")
    assert compiler is not None
    assert compiler.get("angle") == "radian"  # as MuJoCo writes all models
    compiler.set("meshdir", FOLDER)
    for mesh in root.iterfind("./asset/mesh"):
        for key in INLINE:
            mesh.attrib.pop(key, None)
        mesh.set("file", f"{mesh.get('name')}.stl")
        _write_file(folder / FOLDER / f"{mesh.get('name')}.stl", meshes.hulls[mesh.get("name", "")].stl())
    ElementTree.indent(root)
    _write_file(file, ElementTree.tostring(root, encoding="utf-8") + b"\n")
    mujoco.MjModel.from_xml_path(str(file))
    return file


def _write_file(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def _write_exactly(root: ElementTree.Element, model: mujoco.MjModel) -> None:
    """Replace the printed numbers of bodies, inertias and joints by those of the compiled model."""
    for element in root.iterfind(".//body"):
        body = model.body(element.get("name", ""))
        _write_pose(element, body.pos, body.quat)
        inertial = element.find("inertial")
        if inertial is not None:
            _write_pose(inertial, body.ipos, body.iquat)
            _replace(inertial, "mass", body.mass)
            _replace(inertial, "diaginertia", body.inertia)
        for joint in element.iterfind("joint[@name]"):
            compiled = model.joint(joint.get("name", ""))
            _replace(joint, "axis", compiled.axis)
            _replace(joint, "pos", compiled.pos)
            _replace(joint, "range", compiled.range)


def _write_pose(element: ElementTree.Element, position: Any, rotation: Any) -> None:
    for key, values, default in (("pos", position, ZERO), ("quat", rotation, IDENTITY)):
        if element.get(key) is None and not np.array_equal(values, default):
            element.set(key, " ".join(map(repr, default)))
        _replace(element, key, values)


def _replace(element: ElementTree.Element, key: str, values: Any) -> None:
    """Write a printed attribute with all digits. Another value means another frame and is left alone."""
    printed = element.get(key)
    if printed is None:
        return
    numbers = np.array(printed.split(), dtype=np.float64)
    exact = np.asarray(values, dtype=np.float64).ravel()
    bound = PRINTED * max(1e-6, float(np.abs(exact).max(initial=0.0)))
    if numbers.shape == exact.shape and np.abs(numbers - exact).max() <= bound:
        element.set(key, " ".join(map(repr, exact.tolist())))
