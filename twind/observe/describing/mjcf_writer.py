"""MJCF of a robot with its identified model, in one file with its assets: for simulators and trainers.

The text of the robot's model is edited, because MuJoCo's own writer rounds numbers to six digits. The result
is compiled again and compared. Not in it: load-dependent friction and play (`twind/twin/servo_effects.py`).
"""

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from twind.config.robot_spec import RobotFile
from twind.exceptions import InvalidInput
from twind.twin.binding import bind
from twind.twin.identified_model import apply_identified

FOLDERS = {"mesh": "meshdir", "skin": "meshdir", "texture": "texturedir", "hfield": "meshdir"}
FILES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")
CLOSE = 1e-12  # relative difference of a compiled number that counts as the same
MOST_INCLUDES = 64


def write_mjcf(robot: RobotFile, path: Path) -> None:
    """Write the model to `path`, and its assets into the folder `STEM-assets` beside it.

    Folders on the way are made. Raises InvalidInput: a model that is not valid or cannot be written so;
    nothing that this call made is left then. OSError: also if another program makes one of them meanwhile.
    """
    assets = path.with_name(f"{path.stem}-assets")
    for place in (path, assets):
        if os.path.lexists(place):
            raise InvalidInput(f"{place} exists: remove it, or name another file")
    bind(robot, None)  # refuses a model that MuJoCo cannot compile
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    apply_identified(spec, robot)
    root = _included(_parsed(robot.mjcf_path), robot.mjcf_path.parent)
    _set_identified(root, spec, robot)
    path.parent.mkdir(parents=True, exist_ok=True)
    with ExitStack() as undo:  # knows only what this call made
        _copy_assets(root, robot.mjcf_path.parent, assets, undo)
        ElementTree.indent(root)
        with path.open("x", encoding="utf-8") as file:
            undo.callback(path.unlink, missing_ok=True)
            file.write(ElementTree.tostring(root, encoding="unicode") + "\n")
        _require_same(spec.compile(), path)
        undo.pop_all()


def _included(root: Element, folder: Path) -> Element:
    """Replace each `<include>` by the content of its file. Raises InvalidInput."""
    for _ in range(MOST_INCLUDES):
        found = [(parent, child) for parent in root.iter() for child in parent if child.tag == "include"]
        if not found:
            return root
        parent, child = found[0]
        place = list(parent).index(child)
        parent.remove(child)
        for number, each in enumerate(_parsed(folder / child.get("file", ""))):
            parent.insert(place + number, each)
    raise InvalidInput(f"the model includes more than {MOST_INCLUDES} files, or itself")


def _parsed(path: Path) -> Element:
    """Raises InvalidInput for what MuJoCo reads although it is not XML."""
    try:
        return ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise InvalidInput(f"{path}: is not XML: {error}") from None


def _set_identified(root: Element, spec: Any, robot: RobotFile) -> None:
    """Write what `apply_identified` set in `spec` as attributes."""
    identified = robot.identified
    if identified is None:
        return
    elements = {each.get("name"): each for each in root.iter("joint") if each.get("name")}
    for joint in robot.joints:
        element = elements.get(joint.model_joint)
        if joint.name not in identified.joints or element is None:
            continue
        hinge = spec.joint(joint.model_joint)
        _set(element, "solimpfriction", hinge.solimp_friction)
        _set(element, "solreffriction", hinge.solref_friction)
        _set(element, "frictionloss", [hinge.frictionloss])
        _set(element, "armature", [hinge.armature])
        _set(element, "damping", np.trim_zeros(np.atleast_1d(hinge.damping), "b"))
        for servo in spec.actuators:
            if servo.trntype == mujoco.mjtTrn.mjTRN_JOINT and servo.target == joint.model_joint:
                _set_servo(_servo_element(root, joint.model_joint), servo)
    for name in identified.bodies:
        _set_body(next(each for each in root.iter("body") if each.get("name") == name), spec.body(name))


def _servo_element(root: Element, joint: str) -> Element:
    for group in root.iter("actuator"):
        for element in group:
            if element.get("joint") == joint:
                return element
    raise InvalidInput(f"joint {joint}: its actuator has no attribute joint in the model")


def _set_servo(element: Element, servo: Any) -> None:
    if element.tag == "position":
        _set(element, "kp", servo.gainprm[:1])
        _set(element, "kv", -servo.biasprm[2:3])
    else:
        _set(element, "gainprm", servo.gainprm)
        _set(element, "biasprm", servo.biasprm)
    _set(element, "forcerange", servo.forcerange)
    if servo.delay > 0.0:
        _set(element, "delay", [servo.delay])
        element.set("nsample", str(servo.nsample))
        element.set("interp", "linear")


def _set_body(element: Element, body: Any) -> None:
    for old in element.findall("inertial"):
        element.remove(old)
    inertial = SubElement(element, "inertial")
    _set(inertial, "mass", [body.mass])
    _set(inertial, "diaginertia", body.inertia)
    _set(inertial, "pos", body.ipos)
    _set(inertial, "quat", body.iquat)


def _copy_assets(root: Element, source: Path, assets: Path, undo: ExitStack) -> None:
    """Copy each file that the model names into a new folder, and name the copy."""
    compilers = list(root.iter("compiler"))
    given = {key: value for each in compilers for key, value in each.items()}
    common = given.get("assetdir", "")
    names: dict[Path, str] = {}
    for element, key in _file_attributes(root):
        file = Path(element.get(key, ""))
        if given.get("strippath") == "true":
            file = Path(file.name)
        found = (source / given.get(FOLDERS[element.tag], common) / file).resolve()
        if found not in names:
            stem = file.name if file.name not in names.values() else f"{len(names)}-{file.name}"
            if not names:
                assets.mkdir()
                undo.callback(shutil.rmtree, assets, ignore_errors=True)
            with found.open("rb") as original, (assets / stem).open("xb") as copy:
                shutil.copyfileobj(original, copy)
            names[found] = stem
        if element.tag == "mesh" and element.get("name") is None:
            element.set("name", file.stem)
        element.set(key, f"{assets.name}/{names[found]}")
    for each in compilers:
        for key in ("assetdir", "meshdir", "texturedir", "strippath"):
            each.attrib.pop(key, None)


def _file_attributes(root: Element) -> Iterator[tuple[Element, str]]:
    for element in root.iter():
        if element.tag in FOLDERS:
            yield from ((element, key) for key in FILES if element.get(key))


def _require_same(wanted: Any, path: Path) -> None:
    """Raises InvalidInput where the file compiles to other numbers than `wanted`."""
    try:
        model: Any = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise InvalidInput(
            f"the model cannot be written as one file: {' '.join(str(error).split())}"
        ) from None
    for name in dir(wanted):
        if name.startswith("_") or "path" in name:  # sizes and paths differ by the names of files
            continue
        expected = getattr(wanted, name)
        if isinstance(expected, np.ndarray) and expected.dtype.kind in "fiu":
            found = getattr(model, name)
            if found.shape != expected.shape or not np.allclose(
                found, expected, CLOSE, CLOSE, equal_nan=True
            ):
                raise InvalidInput(f"the model cannot be written as one file: its {name} would differ")


def _set(element: Element, key: str, values: Sequence[float] | Any) -> None:
    element.set(key, " ".join(repr(float(each)) for each in values) or "0")
