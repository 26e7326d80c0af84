"""Reading of a URDF by MuJoCo: links and joints are written anew, with numbers checked and meshes as hulls.

MuJoCo sees nothing else of the file: no plugin, no path, no setting of its own.
"""

from collections.abc import Mapping
from xml.etree import ElementTree

import mujoco
import numpy as np

from twind_calibration.model_import.imported_model import RemarkList
from twind_calibration.model_import.mesh_library import MeshLibrary
from twind_calibration.model_import.urdf_checks import UrdfRobot, inertia_matrix, link_mass
from twind_calibration.model_import.xml_tree import XmlElement

# Attributes of each shape: how many numbers.
SHAPES: Mapping[str, Mapping[str, int]] = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
}
# All links stay bodies, shapes for the eye stay geoms; all angles are radians.
COMPILER = {"fusestatic": "false", "discardvisual": "false", "balanceinertia": "true", "angle": "radian"}


def read_urdf(robot: UrdfRobot, meshes: MeshLibrary, remarks: RemarkList) -> mujoco.MjSpec:
    """Spec of a checked robot. Raises InvalidInput; ValueError: MuJoCo cannot read it."""
    root = ElementTree.Element("robot", name=robot.name)
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", COMPILER)
    for name, link in robot.links.items():
        _write_link(ElementTree.SubElement(root, "link", name=name), link, meshes, remarks)
    for name, joint in robot.joints.items():
        kind = joint.required("type")
        _write_joint(ElementTree.SubElement(root, "joint", name=name, type=kind), joint)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    meshes.fill(spec)
    return spec


def _write_link(
    into: ElementTree.Element, link: XmlElement, meshes: MeshLibrary, remarks: RemarkList
) -> None:
    inertial = link.first("inertial")
    inertia = None if inertial is None else inertial.first("inertia")
    if inertial is not None and inertia is not None:
        written = ElementTree.SubElement(into, "inertial")
        _write_origin(written, inertial)
        mass = link_mass(link)
        ElementTree.SubElement(written, "mass", value=repr(mass))
        matrix = inertia_matrix(inertia) if mass > 0.0 else np.zeros((3, 3))
        entries = {f"i{'xyz'[a]}{'xyz'[b]}": repr(float(matrix[a, b])) for a in range(3) for b in range(a, 3)}
        ElementTree.SubElement(written, "inertia", entries)
    shapes = link.all("collision")
    if not shapes and link.all("visual"):
        shapes = link.all("visual")
        reason = "no <collision>: it is drawn by its visual shapes and collides with nothing"
        remarks.add(link.place, f"link {link.required('name')!r}: {reason}")
    for shape in shapes:
        written = ElementTree.SubElement(into, shape.tag)
        _write_origin(written, shape)
        _write_geometry(ElementTree.SubElement(written, "geometry"), shape, meshes)


def _write_geometry(into: ElementTree.Element, shape: XmlElement, meshes: MeshLibrary) -> None:
    geometry = shape.first("geometry")
    if geometry is None or len(geometry.children) != 1:
        raise shape.refused(f"<{shape.tag}> needs one <geometry> with one shape; write it")
    form = geometry.children[0]
    if form.tag == "mesh":
        scale = form.numbers("scale", 3, (1.0, 1.0, 1.0))
        name = meshes.add(form.required("filename"), scale, form.place)
        ElementTree.SubElement(into, "mesh", filename=f"{name}.stl")
        return
    if form.tag not in SHAPES:
        known = ", ".join([*SHAPES, "mesh"])
        raise form.refused(f"unknown shape <{form.tag}>; shapes are {known}")
    sizes = {key: form.numbers(key, count) for key, count in SHAPES[form.tag].items()}
    for key, values in sizes.items():
        if min(values) <= 0.0:
            raise form.refused(f"<{form.tag}>: {key} {min(values):g} m must be above 0; correct it")
    ElementTree.SubElement(into, form.tag, {key: _text(values) for key, values in sizes.items()})


def _write_joint(into: ElementTree.Element, joint: XmlElement) -> None:
    _write_origin(into, joint)
    for end in ("parent", "child"):
        element = joint.first(end)
        assert element is not None  # checked before
        ElementTree.SubElement(into, end, link=element.required("link"))
    if joint.required("type") == "fixed":
        return
    axis = joint.first("axis")
    ElementTree.SubElement(
        into, "axis", xyz=_text((1.0, 0.0, 0.0) if axis is None else axis.numbers("xyz", 3))
    )
    _copy_numbers(into, joint, "limit", ("lower", "upper", "effort"))
    _copy_numbers(into, joint, "dynamics", ("damping", "friction"))
    mimic = joint.first("mimic")
    if mimic is not None:
        values = {
            key: repr(mimic.number(key, default)) for key, default in (("multiplier", 1.0), ("offset", 0.0))
        }
        ElementTree.SubElement(into, "mimic", {"joint": mimic.required("joint"), **values})


def _copy_numbers(into: ElementTree.Element, joint: XmlElement, tag: str, keys: tuple[str, ...]) -> None:
    element = joint.first(tag)
    if element is None:
        return
    given = [key for key in keys if key in element.attributes]
    values = {key: repr(element.number(key)) for key in given if key != "effort" or element.number(key) > 0.0}
    if joint.required("type") == "continuous":
        values = {key: value for key, value in values.items() if key not in ("lower", "upper")}
    ElementTree.SubElement(into, tag, values)


def _write_origin(into: ElementTree.Element, element: XmlElement) -> None:
    origin = element.first("origin")
    if origin is not None:
        zero = (0.0, 0.0, 0.0)
        values = {key: _text(origin.numbers(key, 3, zero)) for key in ("xyz", "rpy")}
        ElementTree.SubElement(into, "origin", values)


def _text(values: tuple[float, ...]) -> str:
    return " ".join(map(repr, values))
