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
# m from the robot; degrees around it, and seen from above
AWAY = 1.6
ASIDE = 130.0
ABOVE = -12.0


class CameraRenderer:
    """A camera that goes along with the base. Holds a GL context of its own until `close`.

    Not `mujoco.Renderer`: that takes the context that was chosen while MuJoCo was imported, and to the twin's
    users MuJoCo is imported with none.
    """

    def __init__(self, model: Any, base: str) -> None:
        """Raises OperationFailed: neither EGL nor OSMesa works here."""
        self._model = model
        number = model.body(base).id
        self._context: Any = _context()
        self._scene: Any = mujoco.MjvScene(model, maxgeom=model.ngeom + 1000)
        for costly in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[costly] = False  # ten times the time of all else, in software
        self._camera: Any = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        self._camera.trackbodyid = number
        self._camera.distance = AWAY
        self._camera.azimuth = ASIDE
        self._camera.elevation = ABOVE
        self._option: Any = mujoco.MjvOption()
        if not _seen(model, number):
            self._option.geomgroup[3] = True  # where collision shapes are by custom
        self._perturb: Any = mujoco.MjvPerturb()
        model.vis.global_.offheight, model.vis.global_.offwidth = SIZE  # of the buffer that is drawn into
        self._drawing: Any = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)

    def take(self, data: Any) -> NDArray[np.uint8]:
        """Return the picture of the camera, (480, 640, 3): a new array."""
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


def _seen(model: Any, base: int) -> bool:
    """The robot has a shape in one of the groups that are shown."""
    robot = model.body_rootid[model.geom_bodyid] == model.body_rootid[base]
    return bool((model.geom_group[robot] < 3).any())
