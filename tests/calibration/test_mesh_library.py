"""Meshes of each format become the same hull, in metres and in the frame of the file."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from twind.exceptions import InvalidInput
from twind_calibration.model_import.imported_model import RemarkList
from twind_calibration.model_import.mesh_library import MAX_VERTICES, MeshLibrary, convex_hull, load_vertices
from twind_calibration.model_import.package_paths import PackagePaths

SIZE = (0.1, 0.2, 0.3)  # m
MOVED = (1.0, 2.0, 3.0)  # m


def box() -> trimesh.Trimesh:
    mesh = trimesh.creation.box(SIZE)
    mesh.apply_translation(MOVED)
    return mesh


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "dae"])
def test_a_mesh_of_each_format_has_its_place_and_size(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"box.{kind}"
    box().export(path)
    hull = convex_hull(load_vertices(path, "here"), "box", "here")
    assert (len(hull.corners), len(hull.faces)) == (8, 12)
    np.testing.assert_allclose(hull.corners.min(axis=0), np.subtract(MOVED, np.divide(SIZE, 2)), atol=1e-6)
    np.testing.assert_allclose(hull.corners.max(axis=0), np.add(MOVED, np.divide(SIZE, 2)), atol=1e-6)


def test_collada_in_millimetres_is_read_in_metres(tmp_path: Path) -> None:
    path = tmp_path / "box.dae"
    box().export(path)
    text = path.read_text()
    path.write_text(text.replace("<asset>", '<asset><unit name="millimeter" meter="0.001"/>'))
    np.testing.assert_allclose(load_vertices(path, "here").max(axis=0) * 1e3, [1.05, 2.1, 3.15])


def test_faces_of_a_hull_look_outwards(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    hull = convex_hull(np.asarray(mesh.vertices), "ball", "here")
    assert len(hull.corners) == MAX_VERTICES
    solid = trimesh.Trimesh(hull.corners, hull.faces, process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(mesh.volume, rel=0.15)
    assert 0.0 < hull.outside(np.asarray(mesh.vertices)) < 0.006
    (tmp_path / "hull.stl").write_bytes(hull.stl())
    again = load_vertices(tmp_path / "hull.stl", "here")
    assert hull.outside(again) < 1e-6


def test_a_flat_mesh_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"^here: mesh plate: no convex hull: .*a flat mesh has no volume"):
        convex_hull(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=float), "plate", "here")


def test_a_mesh_is_read_once_for_each_scale(tmp_path: Path) -> None:
    box().export(tmp_path / "box.stl")
    library = MeshLibrary(PackagePaths(tmp_path, {"bot": tmp_path}, {}), RemarkList())
    names = [
        library.add("package://bot/box.stl", (1.0, 1.0, 1.0), "here"),
        library.add("box.stl", (1.0, 1.0, 1.0), "here"),
        library.add("model://bot/box.stl", (0.1, 0.1, -0.1), "here"),
    ]
    assert names == ["box", "box", "box_2"]


@pytest.mark.parametrize(
    "reference", ["package://bot/../secret.stl", "https://bot/box.stl", "package://../box.stl"]
)
def test_a_path_out_of_a_package_is_refused(tmp_path: Path, reference: str) -> None:
    paths = PackagePaths(tmp_path, {"bot": tmp_path / "bot"}, {})
    (tmp_path / "bot").mkdir()
    with pytest.raises(InvalidInput, match=r"^here: "):
        paths.resolve(reference, "here")


def test_packages_are_found_on_the_paths_of_ros_and_above_the_file(tmp_path: Path) -> None:
    start = tmp_path / "work" / "arm_description" / "urdf"
    start.mkdir(parents=True)
    (start.parent / "package.xml").write_text("<package><name>arm_description</name></package>")
    for folder in ("ros1/hand", "ament/share/eye", "work/neck"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "work" / "neck" / "package.xml").write_text("<package><name>neck</name></package>")
    environment = {
        "ROS_PACKAGE_PATH": str(tmp_path / "ros1"),
        "AMENT_PREFIX_PATH": f"/opt/no:{tmp_path / 'ament'}",
    }
    paths = PackagePaths(start, {}, environment)
    found = [paths.find(name, "here") for name in ("arm_description", "hand", "eye", "neck")]
    assert found == [
        start.parent,
        tmp_path / "ros1/hand",
        tmp_path / "ament/share/eye",
        tmp_path / "work/neck",
    ]
