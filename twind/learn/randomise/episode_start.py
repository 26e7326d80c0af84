"""State that an episode begins in: the robot on the floor, a little off its pose, and histories of delays."""

from typing import Any

import mujoco
import numpy as np

from twind.learn.randomise.physics_randomiser import ModelAddresses
from twind.learn.randomise.randomisation_ranges import EpisodeDraw
from twind.robot.arrays import Floats, Ints
from twind.twin.base_pose import touch_down, touching


class EpisodeStart:
    """Begins episodes of one robot near a pose. Needs the model as it was compiled, and leaves it so."""

    def __init__(self, model: Any, at: ModelAddresses, stance: Floats) -> None:
        """`stance` (nq,): the robot on its feet."""
        self._model = model
        self._at = at
        self._stance = stance
        self._geoms = touching(model)
        self._data = data = mujoco.MjData(model)
        turn = at.base_qpos + 3
        self._qpos = data.qpos
        self._orientation = data.qpos[turn : turn + 4]
        limited = model.jnt_limited[at.joints] != 0
        self._lower = np.where(limited, model.jnt_range[at.joints, 0], -np.inf)
        self._upper = np.where(limited, model.jnt_range[at.joints, 1], np.inf)

    def state(self, draw: EpisodeDraw) -> tuple[Floats, Floats]:
        """qpos (nq,) as the encoders say it, and qvel (nv,): joints within their stops, feet on the floor.

        The floor's place depends on shapes alone, so the compiled model gives it, whatever is drawn.
        """
        at = self._at
        velocity = np.zeros(self._model.nv)
        velocity[at.base_dof : at.base_dof + 2] = draw.start_velocity
        qpos = self._stance.copy()
        if not (draw.start_joints.any() or draw.start_tilt.any() or draw.encoder_zero.any()):
            return qpos, velocity
        joints = (qpos[at.qpos] + draw.start_joints - draw.encoder_zero).clip(self._lower, self._upper)
        self._qpos[:] = qpos
        self._qpos[at.qpos] = joints
        mujoco.mju_quatIntegrate(self._orientation, np.array([*draw.start_tilt, 0.0]), 1.0)
        touch_down(self._model, self._data, at.base_qpos + 2, self._geoms)
        qpos[:] = self._qpos
        qpos[at.qpos] = joints + draw.encoder_zero
        return qpos, velocity


_HEADER = 2  # of a buffer: what its user keeps, and the cursor; then the times, then the samples


class DelayHistories:
    """Places in `mjData.history` of the samples of a model's controls and sensors."""

    def __init__(self, model: Any) -> None:
        kept = zip(model.actuator_historyadr, model.actuator_history[:, 0], strict=True)
        self._controls = [
            (control, _slots(at, samples, 1)) for control, (at, samples) in enumerate(kept) if samples
        ]
        sensors = zip(
            model.sensor_historyadr,
            model.sensor_history[:, 0],
            model.sensor_adr,
            model.sensor_dim,
            strict=True,
        )
        self._sensors = [
            (slice(first, first + size), _slots(at, samples, size))
            for at, samples, first, size in sensors
            if samples
        ]

    def fill_controls(self, history: Floats, control: Floats) -> None:
        """The controls were `control` (nu,) all along; `history` (nhistory,) is changed."""
        for each, slots in self._controls:
            history[slots] = control[each]

    def fill_sensors(self, history: Floats, values: Floats) -> None:
        """The sensors read `values` (nsensordata,) all along: those of a forward pass without delay."""
        for of, slots in self._sensors:
            history[slots] = values[of]


def _slots(address: int, samples: int, size: int) -> Ints:
    """(samples, size): the places in `history` of a buffer that begins at `address`."""
    first = address + _HEADER + samples
    return np.arange(first, first + samples * size, dtype=np.int64).reshape(samples, size)
