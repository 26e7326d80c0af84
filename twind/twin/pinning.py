"""Pinning: removes the free joint of a robot's base and leaves its contacts as they are while it floats.

MuJoCo filters contacts between a body and its parent, unless the parent is fastened to the world: then the
parent counts as world, and its children collide with it. The pairs that this filter removes from the floating
model are therefore excluded by name. A pinned base and the world no longer meet: both stand still.
"""

from collections.abc import Iterator
from typing import Any

import mujoco


def pin(spec: mujoco.MjSpec, base: Any) -> None:
    """Fasten `base`, a body of `spec`, where the model puts it. A base without a free joint stays as it is.

    Key poses are removed: their `qpos` has the place of a floating base.
    """
    free = free_joints(base)
    if not free:
        return
    for element in [*free, *spec.keys]:
        spec.delete(element)
    spec.compiler.fusestatic = False  # the compiler would merge a base without joints into the world
    exclude_children(spec, base)


def free_joints(body: Any) -> list[Any]:
    """Free joints of one body of a spec: one or none."""
    return [joint for joint in body.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]


def exclude_children(spec: mujoco.MjSpec, base: Any) -> None:
    """Exclude what the parent filter removes: bodies welded to `base` with bodies welded to its children.

    A model without that filter stays as it is.
    """
    if spec.option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        return
    welded = list(_weld_group(base))
    for parent in welded:
        for child in parent.bodies:
            if child.joints:
                for other in _weld_group(child):
                    for one in welded:
                        spec.add_exclude(bodyname1=_name(spec, one), bodyname2=_name(spec, other))


def _weld_group(body: Any) -> Iterator[Any]:
    """`body` and its descendants that no joint separates from it."""
    yield body
    for child in body.bodies:
        if not child.joints:
            yield from _weld_group(child)


def _name(spec: mujoco.MjSpec, body: Any) -> str:
    """Name of a body. An unnamed body gets one, because an exclusion needs it."""
    if not body.name:
        name = f"body {body.id}"
        while spec.body(name) is not None:
            name += "'"
        body.name = name
    return str(body.name)
