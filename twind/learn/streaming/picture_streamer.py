"""Pictures of the robot as its twin has it, drawn off screen and sent as JPEG among the samples.

A thread at a rate of its own: drawing in software takes 10 ms and more, which no other thread here waits for.
The base stands where the model has it, as in `twindctl view`: no sensor of the stream tells where it is.
"""

import argparse
import io
import threading
import time
from collections.abc import Callable

import numpy as np

from twind.client import ClientError
from twind.client.clock_pair import ClockPair, clocks
from twind.command_line.verb import observer
from twind.exceptions import OperationFailed
from twind.learn.environment.camera_renderer import CameraRenderer
from twind.learn.streaming.sample_batcher import SampleBatcher
from twind.learn.streaming.stream_samples import ROWS, StreamSample, picture
from twind.observe.viewing.robot_model import RobotModel

QUALITY = 80  # of JPEG: 640x480 are 20 kB
AGAIN = 5.0  # s until a robot that cannot be drawn is asked for anew
POSITION = ROWS.index("position")
NAME = "render"


class CameraScene:
    """One robot, drawn. Of one thread: the GL context belongs to it."""

    def __init__(self, answer: dict[str, object]) -> None:
        """Load the robot; `answer`: of GetRobot. Raises OperationFailed."""
        import mujoco

        self._likeness = RobotModel(answer)
        self._model = self._likeness.model
        self._data = mujoco.MjData(self._model)
        self._steps = (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight)
        self._picture = CameraRenderer(self._model, self._likeness.base, steady=True)

    def fits(self, sample: StreamSample) -> bool:
        """The sample is of these joints."""
        return tuple(sample.names) == self._likeness.joints

    def jpeg(self, sample: StreamSample) -> bytes:
        """The robot in that pose; joints that are not known are as at rest."""
        from PIL import Image

        position = np.array(sample.rows[POSITION], dtype=float)
        known = np.where(np.isfinite(position), position, self._likeness.rest)
        self._data.qpos[self._likeness.qpos] = known
        for step in self._steps:
            step(self._model, self._data)
        out = io.BytesIO()
        Image.fromarray(self._picture.take(self._data)).save(out, "JPEG", quality=QUALITY)
        return out.getvalue()

    def close(self) -> None:
        """Give the GL context back."""
        self._picture.close()


class PictureStreamer:
    """Puts a picture of the newest sample into the basket, `rate` times a second at most."""

    def __init__(
        self, options: argparse.Namespace, batcher: SampleBatcher, rate: float, tell: Callable[[str], None]
    ) -> None:
        self._options = options
        self._basket = batcher
        self._period = 1.0 / rate
        self._tell = tell
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._reported = ""

    def start(self) -> None:
        """Begin to draw."""
        self._thread.start()

    def stop(self) -> None:
        """Draw no more."""
        self._stop.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        scene: CameraScene | None = None
        drawn = -1
        wait = 0.0
        while not self._stop.wait(wait):
            begun = time.monotonic()
            sample = self._basket.latest
            wait = self._period
            if sample is None or sample.tick == drawn:
                continue
            try:
                if scene is None or not scene.fits(sample):
                    scene = self._scene(scene)
                self._put(scene.jpeg(sample), sample)
                drawn = sample.tick
                wait = max(0.0, self._period - (time.monotonic() - begun))
            except (OperationFailed, ClientError, ValueError) as error:
                self._complain(str(error))
                wait = AGAIN
        if scene is not None:
            scene.close()

    def _scene(self, old: CameraScene | None) -> CameraScene:
        if old is not None:
            old.close()
        with observer(self._options) as client:
            return CameraScene(client.call("GetRobot"))

    def _put(self, jpeg: bytes, sample: StreamSample) -> None:
        """With the time of the sample, which is that of the pose."""
        now = clocks()
        self._basket.add(picture(jpeg, NAME, ClockPair(sample.time, now.wall(sample.time))))

    def _complain(self, why: str) -> None:
        if why != self._reported:
            self._reported = why
            self._tell(f"no pictures: {why}")
