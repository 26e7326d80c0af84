"""Pictures of a model into an .mp4 file (H.264): by ffmpeg, which the package imageio-ffmpeg brings along."""

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

        if path.exists():
            raise OperationFailed(f"{path}: is there already, and is never written over; name another file")
        self.path = path
        self.frames = 0
        self._model = model
        self._renderer = CameraRenderer(model, base, steady=True)
        high, wide = SIZE
        self._encoder: Any = imageio_ffmpeg.write_frames(
            str(path), (wide, high), fps=fps, output_params=["-movflags", "+faststart"]
        )
        self._encoder.send(None)

    def add(self, data: Any) -> None:
        """Draw the state of `data` (mujoco.MjData) as the next picture. Raises OperationFailed."""
        for step in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
            step(self._model, data)
        try:
            self._encoder.send(self._renderer.take(data).tobytes())
        except (OSError, StopIteration) as error:
            raise OperationFailed(
                f"{self.path}: the encoder ended: {' '.join(str(error).split())[:200]}"
            ) from None
        self.frames += 1

    def close(self) -> None:
        """Finish the file."""
        self._encoder.close()
        self._renderer.close()
