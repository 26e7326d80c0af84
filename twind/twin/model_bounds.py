"""Bounds of the numbers of a compiled model: all finite, and those that the daemon relies on within a range.

The text is checked before (`config/model_numbers.py`); meshes and densities give numbers that no text has.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from twind.exceptions import InvalidInput


class QuantityBound(NamedTuple):
    """Range of one array of a model."""

    what: str
    least: float
    most: float
    unit: str


# Wider than any robot, and far from where products of them overflow.
BOUNDS: Mapping[str, QuantityBound] = {
    "body_mass": QuantityBound("mass", 0.0, 1e4, "kg"),
    "body_inertia": QuantityBound("inertia", 0.0, 1e5, "kg m^2"),
    "body_pos": QuantityBound("pos", -1e3, 1e3, "m"),
    "body_ipos": QuantityBound("centre of mass", -1e3, 1e3, "m"),
    "geom_pos": QuantityBound("pos", -1e4, 1e4, "m"),
    "geom_size": QuantityBound("size", 0.0, 1e4, "m"),
    "geom_friction": QuantityBound("friction", 0.0, 1e3, ""),
    "jnt_range": QuantityBound("range", -1e3, 1e3, "rad or m"),
    "jnt_stiffness": QuantityBound("stiffness", 0.0, 1e6, "N m/rad"),
    "dof_damping": QuantityBound("damping", 0.0, 1e6, "N m s/rad"),
    "dof_armature": QuantityBound("armature", 0.0, 1e4, "kg m^2"),
    "dof_frictionloss": QuantityBound("frictionloss", 0.0, 1e6, "N m"),
    "actuator_gainprm": QuantityBound("gain", -1e7, 1e7, ""),
    "actuator_biasprm": QuantityBound("gain", -1e7, 1e7, ""),
    "actuator_forcerange": QuantityBound("forcerange", -1e6, 1e6, "N m"),
    "actuator_gear": QuantityBound("gear", -1e4, 1e4, ""),
}
_OBJECTS = {"body": "body", "geom": "geom", "jnt": "joint", "dof": "joint", "actuator": "actuator"}


def require_sane_model(model: Any, path: Path) -> None:
    """Check every number of a compiled model. Raises InvalidInput: one is not finite or out of bounds."""
    for name in (*BOUNDS, *dir(model)):  # a mass before what follows from it
        numbers = None if name.startswith("_") else getattr(model, name)
        if not isinstance(numbers, np.ndarray) or numbers.dtype.kind != "f" or not numbers.size:
            continue
        bound = BOUNDS.get(name, QuantityBound(name, -np.inf, np.inf, ""))
        wrong = ~(np.isfinite(numbers) & (numbers >= bound.least) & (numbers <= bound.most))
        if wrong.any():
            place = tuple(np.argwhere(wrong)[0])
            what = f"{_owner(model, name, int(place[0]))}{bound.what}"
            limits = f"{bound.least:g} to {bound.most:g} {bound.unit}".rstrip()
            allowed = "finite numbers" if np.isinf(bound.most) else f"numbers from {limits}"
            reason = f"{what} {numbers[place]:g} is out of bounds: the model must give {allowed}; correct it"
            raise InvalidInput(f"{path}: {reason}")


def _owner(model: mujoco.MjModel, array: str, row: int) -> str:
    """Return the named element that a row of an array belongs to, with a colon; empty: it has none."""
    prefix = array.partition("_")[0]
    kind = _OBJECTS.get(prefix)
    if kind is None:
        return ""
    number = int(model.dof_jntid[row]) if prefix == "dof" else row
    return f"{kind} {getattr(model, kind)(number).name or number!r}: "
