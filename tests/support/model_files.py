"""Model files for tests of the import: copies of those in `tests/data/models`, with meshes made here."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from twind_calibration.model_import.imported_model import ImportedModel
from twind_calibration.model_import.model_reading import read_model

DATA = Path(__file__).parents[1] / "data" / "models"


def copied_models(folder: Path) -> Path:
    """Copy of all model files, with a mesh `ball.stl` of 320 faces and a radius of 1 m."""
    copy = folder / "models"
    shutil.copytree(DATA, copy)
    for place in (copy / "meshes", copy / "bot_description" / "meshes"):
        place.mkdir()
        (place / "ball.stl").write_bytes(sphere_stl(2))
    return copy


def sphere_stl(subdivisions: int) -> bytes:
    """Binary STL of a sphere with a radius of 1 m: 20 * 4**subdivisions faces."""
    import trimesh

    data = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0).export(file_type="stl")
    assert isinstance(data, bytes)
    return data


def read_here(path: Path, folder: Path, **given: Any) -> ImportedModel:
    """Import in this process, without packages of the environment."""
    given = {"floating": None, "packages": {}, "arguments": {}, "environment": {}, **given}
    return read_model(path, folder, **given)


def random_angles(model: ImportedModel, count: int, seed: int = 1) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Angles within the limits of the joints that follow no other one, (count, n) rad."""
    ranges = [joint.range or (-3.0, 3.0) for joint in model.joints if joint.mimic is None]
    low, high = np.array(ranges).T
    return np.random.default_rng(seed).uniform(low, high, (count, len(ranges)))
