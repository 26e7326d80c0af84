"""Meshes of a model as convex hulls of at most `MAX_VERTICES` corners, each file and scale once.

`trimesh` reads the files; MuJoCo's own qhull makes the hulls. Textures and colours are not read.
"""

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from twind_calibration.model_import.imported_model import RemarkList, import_refused
from twind_calibration.model_import.package_paths import PackagePaths
from twind_calibration.model_import.xml_tree import parse_xml, read_bytes

FORMATS = ("stl", "obj", "dae", "ply")
MAX_FILE = 64 << 20
MAX_FACES = 1_000_000
MAX_VERTICES = 64
MAX_SIZE = 20.0  # m; a larger mesh is in millimetres
NOTED = 1e-3  # m by which a mesh may stand out of its hull without a remark
FOLDER = "meshes"

Vertices = NDArray[np.float64]  # (n, 3) m


@dataclass(frozen=True, slots=True)
class MeshHull:
    """A convex hull. Corners (v, 3) m, faces (f, 3) numbers of corners, seen from outside anticlockwise."""

    corners: Vertices
    faces: NDArray[np.int64]

    def stl(self) -> bytes:
        """Binary STL."""
        triangles = self.corners[self.faces].astype("<f4")
        record = np.zeros(
            len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("end", "<u2")]
        )
        record["corners"] = triangles
        return bytes(80) + len(triangles).to_bytes(4, "little") + record.tobytes()

    def outside(self, points: Vertices) -> float:
        """Largest distance of a point from the planes of the hull, m; 0 if all are inside."""
        a, b, c = (self.corners[self.faces[:, corner]] for corner in range(3))
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        usable = lengths > 0.0
        normals = normals[usable] / lengths[usable, None]
        offsets = np.einsum("ij,ij->i", normals, a[usable])
        parts = np.array_split(points, len(points) // 10_000 + 1)
        return max(0.0, *(float((part @ normals.T - offsets).max(initial=0.0)) for part in parts))


@dataclass(slots=True)
class MeshLibrary:
    """The meshes of one model."""

    paths: PackagePaths
    remarks: RemarkList
    hulls: dict[str, MeshHull] = field(default_factory=dict)
    _names: dict[tuple[Path, tuple[float, ...]], str] = field(default_factory=dict)

    def add(self, reference: str, scale: tuple[float, ...], place: str) -> str:
        """Read a mesh and return its name in the model. Raises InvalidInput."""
        path = self.paths.resolve(reference, place)
        if (path, scale) not in self._names:
            vertices = load_vertices(path, place) * np.array(scale)
            self._names[path, scale] = self.add_vertices(path.stem, vertices, f"{path.name}", place)
        return self._names[path, scale]

    def add_vertices(self, stem: str, vertices: Vertices, shown: str, place: str) -> str:
        """Add a mesh that was read already. `shown`: its name in messages."""
        size = float(np.ptp(vertices, axis=0).max())
        if not size <= MAX_SIZE:
            remedy = "write its scale, 0.001 0.001 0.001 if it is in millimetres"
            raise import_refused(
                f"mesh {shown}: {size:.4g} m long, at most {MAX_SIZE:g} m; {remedy}", where=place
            )
        hull = convex_hull(vertices, shown, place)
        deviation = hull.outside(vertices)
        if deviation > NOTED:
            text = f"stands up to {deviation * 1e3:.1f} mm out of its hull of {len(hull.corners)} corners"
            self.remarks.add(place, f"mesh {shown} {text}")
        stem = re.sub(r"[^A-Za-z0-9_-]", "_", stem)[:60] or "mesh"
        numbered = (f"{stem}_{number}" for number in count(2))
        name = stem if stem not in self.hulls else next(name for name in numbered if name not in self.hulls)
        self.hulls[name] = hull
        return name

    def fill(self, spec: mujoco.MjSpec) -> None:
        """Put the hulls into a spec in place of its meshes, which have their names."""
        for mesh in list(spec.meshes):
            hull = self.hulls[mesh.name]
            name = str(mesh.name)
            spec.delete(mesh)
            vertices = hull.corners.astype(np.float32).ravel()
            spec.add_mesh(name=name, uservert=vertices, userface=hull.faces.astype(np.int32).ravel())


def load_vertices(path: Path, place: str) -> Vertices:
    """Vertices of a mesh file in its own frame, m. Raises InvalidInput."""
    import trimesh

    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        known = ", ".join(FORMATS)
        raise import_refused(f"mesh {path}: format {kind!r} is not read; convert it to {known}", where=place)
    data = read_bytes(path, MAX_FILE, place)
    if kind == "dae":
        parse_xml(data, str(path))  # refuses entities
    options = {"skip_materials": True} if kind == "obj" else {}
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False, **options)
        parts = [_placed(scene, node) for node in scene.graph.nodes_geometry]
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001 - of a reader of five formats, any error means a bad file
        reason = f"not readable: {type(error).__name__}: {error}"
        raise import_refused(f"mesh {path}: {reason}; export it again", where=place) from None
    if sum(faces for _, faces in parts) > MAX_FACES:
        faces = sum(faces for _, faces in parts)
        raise import_refused(f"mesh {path}: {faces} faces, at most {MAX_FACES}; decimate it", where=place)
    vertices = np.concatenate([each for each, _ in parts]) if parts else np.zeros((0, 3))
    if len(vertices) < 4 or not np.isfinite(vertices).all():
        reason = f"{len(vertices)} vertices, at least 4 finite ones are needed"
        raise import_refused(f"mesh {path}: {reason}; export it again", where=place)
    return vertices


def _placed(scene: Any, node: str) -> tuple[Vertices, int]:
    """Vertices of one part in the frame of the file, m, and its number of faces."""
    transform, name = scene.graph[node]
    part = scene.geometry[name]
    faces = len(getattr(part, "faces", ()))
    unit = str(part.units or "").partition(" * meters")  # COLLADA states its unit
    factor = float(unit[0]) if unit[1] else 1.0
    vertices = np.asarray(part.vertices, dtype=np.float64)
    return (vertices @ transform[:3, :3].T + transform[:3, 3]) * factor, faces


def convex_hull(vertices: Vertices, shown: str, place: str) -> MeshHull:
    """Hull of at most `MAX_VERTICES` corners. Raises InvalidInput for a flat mesh."""
    spec = mujoco.MjSpec()
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))  # as float32, corners far off would move
    spec.add_mesh(name="m", uservert=(vertices - centre).astype(np.float32).ravel(), maxhullvert=MAX_VERTICES)
    try:
        model = spec.compile()
    except ValueError as error:
        reason = f"no convex hull: {str(error).splitlines()[0][:200]}"
        remedy = "a flat mesh has no volume, write a <box>"
        raise import_refused(f"mesh {shown}: {reason}; {remedy}", where=place) from None
    return MeshHull(*_hull_of(model, centre))


def _hull_of(model: Any, centre: Sequence[float]) -> tuple[Vertices, NDArray[np.int64]]:
    """Corners and faces of the hull that MuJoCo made of mesh 0 (mesh_graph in mjmodel.h)."""
    start = int(model.mesh_graphadr[0])
    graph = model.mesh_graph[start:]
    corners, faces = int(graph[0]), int(graph[1])
    used = graph[2 + corners : 2 + 2 * corners].astype(np.int64)
    rows = graph[2 + 3 * corners + 3 * faces :][: 3 * faces].reshape(faces, 3).astype(np.int64)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.mesh_quat[0])
    vertices = (
        model.mesh_vert[used].astype(np.float64) @ rotation.reshape(3, 3).T + model.mesh_pos[0] + centre
    )
    place = np.full(int(model.nmeshvert), -1)
    place[used] = np.arange(corners)
    return vertices, place[rows]
