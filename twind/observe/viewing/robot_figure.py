"""A robot's bodies in a viser scene, below a root of their own: as they look, or as shells of one colour.

Several figures, and several robots, stand beside each other by their roots.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from twind.observe.viewing.robot_model import BodyPoses

# a body that moved less is not sent again
STILL_M = 1e-5
STILL_RAD = 1e-4
INFLATED = 0.002  # m: how far a shell stands off the body that it marks
USUAL = 3  # groups of geoms below it are meant to be seen

Colour = tuple[int, int, int]


def shown_geoms(model: Any, body: int) -> list[int]:
    """Geoms that are drawn of a body: of groups 0 to 2, else of the first group that it has any in.

    A body whose geoms are all in group 3 (as many models have what collides) would not be seen else.
    """
    first = int(model.body_geomadr[body])
    count = int(model.body_geomnum[body])
    seen = [g for g in range(first, first + count) if _alpha(model, g) > 0.0]
    usual = [g for g in seen if model.geom_group[g] < USUAL]
    least = min((int(model.geom_group[g]) for g in seen), default=0)
    return usual or [g for g in seen if model.geom_group[g] == least]


def _alpha(model: Any, geom: int) -> float:
    material = int(model.geom_matid[geom])
    return float(model.mat_rgba[material, 3] if material >= 0 else model.geom_rgba[geom, 3])


class RobotFigure:
    """One robot in one pose. Bodies are numbered as in the model."""

    def __init__(
        self,
        scene: Any,
        root: str,
        model: Any,
        shell: tuple[Colour, float] | None = None,
        *,
        alone: bool = False,
    ) -> None:
        """`shell`: colour and opacity of a figure that is hidden, body by body, until `show`.

        Without it the bodies look as in the model, with the fixed bodies around them. `alone`: without the
        world (body 0), and a shell also of fixed bodies.
        """
        from mjviser.conversions import is_fixed_body

        self._root = scene.add_frame(root, show_axes=False)
        self._frames: dict[int, Any] = {}
        self._shown: dict[int, bool] = {}
        self._meshes: dict[int, Any] = {}
        self._last: BodyPoses | None = None
        for body in range(int(alone), model.nbody):
            geoms = shown_geoms(model, body)
            still = shell is not None and not alone and is_fixed_body(model, body)
            if not geoms or still:
                continue
            name = f"{root}/{body}"
            self._frames[body] = scene.add_frame(name, show_axes=False, visible=shell is None)
            self._shown[body] = shell is None
            if shell is None:
                _solid(scene, name, model, geoms)
            else:
                self._meshes[body] = _shell(scene, f"{name}/shell", model, geoms, shell)

    def place(self, places: BodyPoses) -> None:
        """Bodies that are shown and have moved go there."""
        last = self._last
        moved = None if last is None else places.differ(last, STILL_M, STILL_RAD)
        for body, frame in self._frames.items():
            if self._shown[body] and (moved is None or moved[body]):
                self._put(body, frame, places)
        if last is None:
            self._last = BodyPoses(places.position.copy(), places.rotation.copy())

    def _put(self, body: int, frame: Any, places: BodyPoses) -> None:
        frame.position = places.position[body]
        frame.wxyz = places.rotation[body]
        if self._last is not None:
            self._last.position[body] = places.position[body]
            self._last.rotation[body] = places.rotation[body]

    def show(self, bodies: Any, places: BodyPoses) -> None:
        """Exactly these (nbody,) bool are seen; who appears stands where it is."""
        for body, frame in self._frames.items():
            wanted = bool(bodies[body])
            if wanted != self._shown[body]:
                self._shown[body] = wanted
                if wanted:
                    self._put(body, frame, places)
                frame.visible = wanted

    def mark(self, colours: Mapping[int, Colour], places: BodyPoses) -> None:
        """Exactly these bodies of a shell are seen, each in its colour, where they are."""
        for body, colour in colours.items():
            mesh = self._meshes.get(body)
            if mesh is not None and tuple(mesh.color) != colour:
                mesh.color = colour
        self.show([body in colours for body in range(len(places.position))], places)
        self.place(places)

    def seen(self, *, wanted: bool) -> None:
        """All of it, or nothing."""
        if bool(self._root.visible) != wanted:
            self._root.visible = wanted

    def remove(self) -> None:
        """Out of the scene."""
        self._root.remove()


def _solid(scene: Any, name: str, model: Any, geoms: list[int]) -> None:
    """With their own colours; planes as a grid."""
    import mujoco
    from mjviser.conversions import group_geoms_by_visual_compat, merge_geoms

    flat = [g for g in geoms if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE]
    for geom in flat:
        scene.add_grid(
            f"{name}/plane{geom}",
            infinite_grid=True,
            fade_distance=20.0,
            plane_opacity=0.3,
            shadow_opacity=0.2,
            position=model.geom_pos[geom],
            wxyz=model.geom_quat[geom],
        )
    solid = [g for g in geoms if g not in flat]
    for number, part in enumerate(group_geoms_by_visual_compat(model, solid)):
        scene.add_mesh_trimesh(f"{name}/part{number}", merge_geoms(model, part))


def _shell(scene: Any, name: str, model: Any, geoms: list[int], shell: tuple[Colour, float]) -> Any:
    """One skin around a body, a little off it."""
    from mjviser.conversions import merge_geoms

    mesh = merge_geoms(model, geoms)
    vertices = np.asarray(mesh.vertices) + INFLATED * _outwards(mesh)
    colour, opacity = shell
    return scene.add_mesh_simple(
        name, vertices, mesh.faces, color=colour, opacity=opacity, cast_shadow=False, receive_shadow=False
    )


def _outwards(mesh: Any) -> Any:
    """Unit normals of the vertices (k, 3); trimesh's own want scipy."""
    normals = np.zeros((len(mesh.vertices), 3))
    for corner in np.asarray(mesh.faces).T:
        np.add.at(normals, corner, np.asarray(mesh.face_normals))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
