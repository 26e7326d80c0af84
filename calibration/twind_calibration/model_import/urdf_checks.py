"""Checks of a URDF as a tree of links and joints, before MuJoCo reads it. Errors name file and line.

MuJoCo reads some wrong files without a word: a revolute joint without limits turns freely, limits in degrees
are radians. These are refused here.
"""

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from twind_calibration.model_import.imported_model import RemarkList
from twind_calibration.model_import.xml_tree import XmlElement

MAX_LINKS = 500
LARGEST_ANGLE = 4.0 * math.pi  # rad; limits beyond two turns are degrees
KINDS = ("revolute", "continuous", "prismatic", "fixed")
WORLD = "world"  # MuJoCo takes a link of this name as the world
READ = {"link", "joint", "transmission", "ros2_control"}
WITHOUT_EFFECT = {"material", "mujoco"}  # colours, and settings that the import makes itself


@dataclass(frozen=True, slots=True)
class UrdfRobot:
    """A URDF whose links and joints form one tree."""

    name: str
    element: XmlElement
    links: dict[str, XmlElement]
    joints: dict[str, XmlElement]
    root: str  # name of the link that has no parent


def check_urdf(robot: XmlElement, remarks: RemarkList) -> UrdfRobot:
    """Return the checked robot. Raises InvalidInput."""
    name = robot.required("name")
    links = _named(robot, "link")
    joints = _named(robot, "joint")
    if not links:
        raise robot.refused("the robot has no <link>; name the file that describes it")
    if len(links) > MAX_LINKS:
        raise robot.refused(f"{len(links)} links, at most {MAX_LINKS}; remove those that do not matter")
    for joint in joints.values():
        _check_joint(joint, links, remarks)
    root = _root(robot, links, joints)
    for link in links.values():
        _check_inertial(link, remarks)
    _check_masses(links, joints, root)
    _check_mimics(joints)
    for tag, count in Counter(child.tag for child in robot.children).items():
        if tag not in READ | WITHOUT_EFFECT:
            first = robot.first(tag)
            assert first is not None
            remarks.add(first.place, f"<{tag}> is not read and was dropped ({count} in the file)")
    return UrdfRobot(name, robot, links, joints, root)


def linked(joint: XmlElement, end: str) -> str:
    """Name of the link at one end of a joint: `parent` or `child`."""
    element = joint.first(end)
    if element is None:
        raise joint.refused(f"joint {joint.required('name')!r}: no <{end}>; name its link")
    return element.required("link")


def _named(robot: XmlElement, tag: str) -> dict[str, XmlElement]:
    found: dict[str, XmlElement] = {}
    for element in robot.all(tag):
        name = element.required("name")
        if name in found:
            earlier = found[name].place
            raise element.refused(f"{tag} {name!r} stands twice, first at {earlier}; rename one")
        found[name] = element
    return found


def _check_joint(joint: XmlElement, links: dict[str, XmlElement], remarks: RemarkList) -> None:
    name = joint.required("name")
    kind = joint.required("type")
    if kind in ("planar", "floating"):
        remedy = "fix it, or leave out the joint and its parent and let the base float"
        raise joint.refused(f"joint {name!r}: type {kind}: only joints with one axis are driven; {remedy}")
    if kind not in KINDS:
        raise joint.refused(f"joint {name!r}: unknown type {kind!r}; types are {', '.join(KINDS)}")
    for end in ("parent", "child"):
        if linked(joint, end) not in links:
            raise joint.refused(
                f"joint {name!r}: {end} link {linked(joint, end)!r} does not exist; define it"
            )
    if kind == "prismatic":
        remarks.add(joint.place, f"joint {name!r} slides: it stays in the model, but no servo drives it")
    axis = joint.first("axis")
    if axis is not None and kind != "fixed" and not any(axis.numbers("xyz", 3)):
        raise axis.refused(f"joint {name!r}: axis 0 0 0 has no direction; write one, such as 0 0 1")
    if kind in ("revolute", "prismatic"):
        _check_limits(joint, name, kind)


def _check_limits(joint: XmlElement, name: str, kind: str) -> None:
    limit = joint.first("limit")
    if limit is None:
        raise joint.refused(f"joint {name!r}: no <limit>; write one, or type continuous if it has no stops")
    lower = limit.number("lower", 0.0)
    upper = limit.number("upper", 0.0)
    if not lower < upper:
        bounds = f"lower {lower:g} must be below upper {upper:g}"
        raise limit.refused(f"joint {name!r}: limits: {bounds}; correct them, or type fixed")
    if kind == "revolute" and max(-lower, upper) > LARGEST_ANGLE:
        radians = f"{math.radians(lower):.4g}..{math.radians(upper):.4g}"
        reason = f"limits {lower:g}..{upper:g} look like degrees, at most ±{LARGEST_ANGLE:.4g} rad"
        raise limit.refused(f"joint {name!r}: {reason}; as radians: {radians}, or type continuous")
    for key in ("effort", "velocity"):
        if limit.number(key, 0.0) < 0.0:
            raise limit.refused(f"joint {name!r}: {key} {limit.number(key):g} is below 0; correct it")


def _root(robot: XmlElement, links: dict[str, XmlElement], joints: dict[str, XmlElement]) -> str:
    """Root link. Refuses anything but one tree."""
    parents: dict[str, XmlElement] = {}
    for joint in joints.values():
        child = linked(joint, "child")
        if child in parents:
            names = f"{parents[child].required('name')!r} and {joint.required('name')!r}"
            raise joint.refused(f"link {child!r} is the child of two joints, {names}; remove one")
        parents[child] = joint
    roots = [name for name in links if name not in parents]
    if len(roots) > 1:
        names = ", ".join(roots[:8])
        raise links[roots[1]].refused(f"{len(roots)} root links: {names}; join them by fixed joints")
    reached = {name for name in links if not _is_in_cycle(name, parents)}
    for name, link in links.items():
        if name not in reached:
            raise parents[name].refused(f"link {name!r} is its own ancestor: a cycle of joints; open it")
        if name == WORLD and roots[0] != WORLD:
            raise link.refused(f"link {WORLD!r} is not the root, but MuJoCo takes it so; rename it")
    if roots[0] == WORLD and sum(linked(joint, "parent") == WORLD for joint in joints.values()) != 1:
        raise links[WORLD].refused(f"link {WORLD!r} must carry one link, the robot's base; join the others")
    return roots[0]


def _is_in_cycle(name: str, parents: dict[str, XmlElement]) -> bool:
    """Check whether the way up from a link does not end."""
    for _ in range(len(parents) + 1):
        if name not in parents:
            return False
        name = linked(parents[name], "parent")
    return True


def inertia_matrix(inertia: XmlElement) -> Any:
    """Matrix of an `<inertia>`, kg·m²."""
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    xx, yy, zz, xy, xz, yz = (inertia.number(key, None if key[1] == key[2] else 0.0) for key in keys)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def link_mass(link: XmlElement) -> float:
    """Mass of the `<inertial>` of a link, kg; 0 where it has none."""
    inertial = link.first("inertial")
    mass = None if inertial is None else inertial.first("mass")
    return 0.0 if mass is None else mass.number("value")


def _check_inertial(link: XmlElement, remarks: RemarkList) -> None:
    name = link.required("name")
    inertial = link.first("inertial")
    if inertial is None:
        if link.first("collision") is not None:
            assumed = "1000 kg/m³ of its collision shapes are assumed"
            remarks.add(link.place, f"link {name!r}: no <inertial>: {assumed}")
        return
    for part in ("mass", "inertia"):
        if inertial.first(part) is None:
            raise inertial.refused(f"link {name!r}: <inertial> without <{part}>; write it")
    mass = link_mass(link)
    if mass < 0.0:
        raise inertial.refused(f"link {name!r}: mass {mass:g} kg is below 0; correct it")
    inertia = inertial.first("inertia")
    assert inertia is not None
    moments = np.linalg.eigvalsh(inertia_matrix(inertia))
    shown = ", ".join(f"{value:.3g}" for value in moments)
    if mass > 0.0 and not moments[0] > 0.0:
        reason = f"inertia is not positive definite: principal moments {shown} kg·m², each must be above 0"
        raise inertia.refused(f"link {name!r}: {reason}; export it again")
    if mass > 0.0 and moments[0] + moments[1] < moments[2]:
        reason = (
            f"principal moments {shown} kg·m² belong to no body: the largest exceeds the sum of the others"
        )
        remarks.add(inertia.place, f"link {name!r}: {reason}; their mean is assumed for all three")


def _check_masses(links: dict[str, XmlElement], joints: dict[str, XmlElement], root: str) -> None:
    """Refuse a moving link without mass, unless a link that is fixed to it has one."""
    children: dict[str, list[str]] = {}
    for joint in joints.values():
        if joint.required("type") == "fixed":
            children.setdefault(linked(joint, "parent"), []).append(linked(joint, "child"))
    for joint in joints.values():
        child = linked(joint, "child")
        group = [child] if joint.required("type") != "fixed" else []
        for name in group:
            group += children.get(name, [])
        if group and not any(_has_mass(links[name]) for name in group):
            reason = f"moved by joint {joint.required('name')!r}, has mass 0 kg, must have more"
            raise links[child].refused(f"link {child!r}: {reason}; write its <inertial>")


def _has_mass(link: XmlElement) -> bool:
    if link.first("inertial") is None:
        return link.first("collision") is not None  # MuJoCo gives it the mass of its shapes
    return link_mass(link) > 0.0


def _check_mimics(joints: dict[str, XmlElement]) -> None:
    """Refuse joints that follow a joint which does not exist, does not move, or follows them."""
    for name, joint in joints.items():
        seen = [name]
        mimic = joint.first("mimic")
        while mimic is not None:
            leader = mimic.required("joint")
            if leader not in joints or joints[leader].required("type") == "fixed":
                raise mimic.refused(f"joint {seen[-1]!r} mimics {leader!r}, no joint that moves; name one")
            if leader in seen:
                chain = " -> ".join([*seen, leader])
                raise mimic.refused(f"mimic joints follow each other in a cycle: {chain}; open it")
            seen.append(leader)
            mimic = joints[leader].first("mimic")
