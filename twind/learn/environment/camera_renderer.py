"""Pictures of a simulated robot, without a display: by EGL, else by OSMesa."""

import importlib
import os
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from twind.exceptions import OperationFailed

SIZE = (480, 640)  # pixels, high and wide
WAYS = ("egl", "osmesa")
# degrees around the robot, and seen from above
ASIDE = 130.0
ABOVE = -12.0
ROOM = 1.1  # of the size that the robot fills
ALONE = 0.3  # m, half the size of a robot without any shape
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)


class CameraRenderer:
    """A camera that goes along with the base and sees the whole robot. Holds a GL context until `close`.

    Each picture frames the box around the robot's shapes. A `steady` camera keeps the frame of its first
    picture; its distance grows where the robot reaches further.

    Not `mujoco.Renderer`: that takes the context that was chosen while MuJoCo was imported, and to the twin's
    users MuJoCo is imported with none.
    """

    def __init__(self, model: Any, base: str, *, steady: bool = False) -> None:
        """Raises OperationFailed: neither EGL nor OSMesa works here."""
        self._model = model
        number = model.body(base).id
        self._context: Any = _context()
        self._scene: Any = mujoco.MjvScene(model, maxgeom=model.ngeom + 1000)
        for costly in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[costly] = False  # ten times the time of all else, in software
        self._camera: Any = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        self._camera.distance = 0.0
        self._base = number
        self._steady = steady
        self._offset: NDArray[np.float64] | None = None  # m, from the base to the centre of the first picture
        self._camera.azimuth = ASIDE
        self._camera.elevation = ABOVE
        self._option: Any = mujoco.MjvOption()
        robot = model.body_rootid[model.geom_bodyid] == model.body_rootid[number]
        shown = robot & (model.geom_group < 3)
        if not shown.any():
            self._option.geomgroup[3] = True  # where collision shapes are by custom
            shown = robot & (model.geom_group <= 3)
        self._shapes = np.flatnonzero(shown)
        self._perturb: Any = mujoco.MjvPerturb()
        model.vis.global_.offheight, model.vis.global_.offwidth = SIZE  # of the buffer that is drawn into
        self._drawing: Any = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)

    def take(self, data: Any) -> NDArray[np.uint8]:
        """Return the picture of the camera, (480, 640, 3): a new array."""
        self._frame(data)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._model, data, self._option, self._perturb, self._camera, everything, self._scene
        )
        self._context.make_current()
        frame = mujoco.MjrRect(0, 0, SIZE[1], SIZE[0])
        seen = np.zeros((*SIZE, 3), np.uint8)
        mujoco.mjr_render(frame, self._scene, self._drawing)
        mujoco.mjr_readPixels(seen, None, frame, self._drawing)
        return seen[::-1].copy()  # OpenGL counts rows from below

    def _frame(self, data: Any) -> None:
        """Look at the robot from where all of it is seen."""
        corners = self._corners(data)
        if not self._steady:
            self._camera.distance = 0.0
        if self._offset is None or not self._steady:
            self._offset = (corners.min(axis=0) + corners.max(axis=0)) / 2.0 - data.xpos[self._base]
        centre = data.xpos[self._base] + self._offset
        self._camera.lookat[:] = centre
        height = np.tan(np.radians(self._model.vis.global_.fovy) / 2.0)
        right, up, near = _axes() @ (corners - centre).T
        distances = [np.abs(up) / height, np.abs(right) / (height * SIZE[1] / SIZE[0])]
        self._camera.distance = max(
            self._camera.distance, ROOM * float((np.maximum(*distances) + near).max())
        )

    def _corners(self, data: Any) -> NDArray[np.float64]:
        """Return the corners (k, 3) of the boxes around the robot's shapes, m, in the world."""
        shapes = self._shapes
        if not len(shapes):
            return np.array(data.xpos[self._base] + ALONE * CORNERS)
        boxes = self._model.geom_aabb[shapes]
        local = boxes[:, None, :3] + CORNERS * boxes[:, None, 3:]
        turned = np.einsum("gij,gkj->gki", data.geom_xmat[shapes].reshape(-1, 3, 3), local)
        return np.array((data.geom_xpos[shapes][:, None] + turned).reshape(-1, 3))

    def close(self) -> None:
        """Give the context back; may be called twice."""
        if self._context is not None:
            self._context.make_current()
            self._drawing.free()
            self._context.free()
            self._context = None


def _context() -> Any:
    """A GL context of our own: the one that MuJoCo chose while it was imported may be none."""
    wanted = os.environ.get("MUJOCO_GL", "")
    refusals = []
    for way in (wanted,) if wanted in WAYS else WAYS:
        before = os.environ.pop("PYOPENGL_PLATFORM", None)
        try:
            context = importlib.import_module(f"mujoco.{way}").GLContext(SIZE[1], SIZE[0])
            context.make_current()
            return context
        except (ImportError, RuntimeError, AttributeError, OSError) as error:
            refusals.append(f"{way}: {error}")
            if before is not None:
                os.environ["PYOPENGL_PLATFORM"] = before
    raise OperationFailed(
        f"no picture without a display ({'; '.join(refusals)}): install libegl1 or libosmesa6"
    )


def _axes() -> NDArray[np.float64]:
    """Return the camera's axes as rows (3, 3), in the world: right, up, and from the robot to the camera."""
    around, above = np.radians((ASIDE, ABOVE))
    ahead = np.array([np.cos(above) * np.cos(around), np.cos(above) * np.sin(around), np.sin(above)])
    right = np.array([np.sin(around), -np.cos(around), 0.0])
    return np.stack([right, np.cross(right, ahead), -ahead])
