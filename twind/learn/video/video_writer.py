"""Pictures of a model into an .mp4 file (H.264): by ffmpeg, which the package imageio-ffmpeg brings along."""

import os
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco

from twind.command_line.extras import how_to_add
from twind.exceptions import OperationFailed
from twind.learn.environment.camera_renderer import SIZE, CameraRenderer

FPS = 25.0  # pictures per second


def require_encoder() -> None:
    """Raises OperationFailed with the extra that is missing."""
    if find_spec("imageio_ffmpeg") is None:
        raise OperationFailed(f"a video needs imageio-ffmpeg: {how_to_add('learn')}")


class VideoWriter:
    """One video that grows by pictures of one model. Holds a GL context and a process until `close`."""

    def __init__(self, path: Path, model: Any, base: str, fps: float = FPS) -> None:
        """Write over no file. Raises OperationFailed: it exists, no encoder, no GL."""
        require_encoder()
        import imageio_ffmpeg

        self.path = path
        self.frames = 0
        self._model = model
        with ExitStack() as undo:  # knows only what this call made
            self._renderer = CameraRenderer(model, base, steady=True)
            undo.callback(self._renderer.close)
            try:
                self._file = path.open("xb")  # never over a link, or a file of others
            except OSError as error:
                there = isinstance(error, FileExistsError)
                why = "is there already, and is never written over" if there else f"{error.strerror}"
                raise OperationFailed(f"{path}: {why}; name another file") from None
            undo.callback(self._file.close)
            undo.callback(path.unlink, missing_ok=True)
            high, wide = SIZE
            self._encoder: Any = imageio_ffmpeg.write_frames(
                # the open file itself: by its name the encoder would follow a link placed there meanwhile
                f"/proc/{os.getpid()}/fd/{self._file.fileno()}",
                (wide, high),
                fps=fps,
                output_params=["-f", "mp4", "-movflags", "+faststart"],
            )
            try:
                self._encoder.send(None)
            except (OSError, RuntimeError) as error:
                raise OperationFailed(f"{path}: the encoder does not start: {_brief(error)}") from None
            undo.pop_all()

    def add(self, data: Any) -> None:
        """Draw the state of `data` (mujoco.MjData) as the next picture. Raises OperationFailed."""
        for step in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
            step(self._model, data)
        try:
            self._encoder.send(self._renderer.take(data).tobytes())
        except (OSError, StopIteration) as error:
            raise OperationFailed(f"{self.path}: the encoder ended: {_brief(error)}") from None
        self.frames += 1

    def close(self) -> None:
        """Finish the file; one that stays empty is removed. Raises OperationFailed: pictures were lost so."""
        self._encoder.close()
        empty = not os.fstat(self._file.fileno()).st_size
        self._file.close()
        self._renderer.close()
        if empty:
            self.path.unlink(missing_ok=True)
        if empty and self.frames:
            raise OperationFailed(f"{self.path}: the encoder wrote nothing; its message is above")


def _brief(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
