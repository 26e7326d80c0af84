"""Model from the text of an MJCF, as daemon and recordings hold it, where its meshes may be out of reach.

Nothing in the text is trusted: its numbers and files are checked, and what may cost more than its text is
compiled in a process with bounds first.
"""

from pathlib import Path
from typing import Any

import mujoco

from twind.config.model_numbers import RECORDED
from twind.config.model_trial import require_readable_text
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.twin.model_bounds import require_sane_model

STAND_IN = 0.03  # m, radius of the sphere in place of a mesh that cannot be read


def compile_model(mjcf: str, folder: str) -> tuple[Any, bool]:
    """Return the model, and whether its files were left out: this user may not read one of them.

    Raises InvalidInput: it cannot be compiled, or would cost memory or time without bound.
    """
    try:
        files_left_out = require_readable_text(mjcf, Path(folder))
    except ConfigError as error:
        raise InvalidInput(str(error)) from None
    model = compile_text(mjcf, folder, files_left_out=files_left_out)
    require_sane_model(model, Path(folder) / RECORDED)
    return model, files_left_out


def compile_text(mjcf: str, folder: str, *, files_left_out: bool) -> Any:
    """Return the model of a text, without a trial; spheres stand for meshes left out. Raises InvalidInput."""
    try:
        spec = mujoco.MjSpec.from_string(mjcf)
        spec.modelfiledir = folder
        if files_left_out:
            _leave_out_files(spec)
        return spec.compile()
    except ValueError as error:
        raise InvalidInput(f"the model cannot be compiled: {' '.join(str(error).split())}") from None


def _leave_out_files(spec: Any) -> None:
    for geom in spec.geoms:
        if geom.type in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD):
            geom.type = mujoco.mjtGeom.mjGEOM_SPHERE
            geom.meshname = ""
            geom.hfieldname = ""
            geom.size = [STAND_IN, 0.0, 0.0]
    for files in (spec.meshes, spec.hfields, spec.textures):
        for each in list(files):
            spec.delete(each)
