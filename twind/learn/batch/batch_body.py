"""The body that is many simulations: what `sim_body` is for one, bit for bit, on a pool of threads."""

import copy
import os
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from twind.learn.environment.camera_renderer import CameraRenderer
from twind.learn.randomise.disturbances import PushSchedule
from twind.learn.randomise.episode_start import DelayHistories, EpisodeStart
from twind.learn.randomise.physics_randomiser import BatchModelWriter, PhysicsRandomiser
from twind.learn.randomise.randomisation_ranges import ZERO, DrawSampler, RandomisationRanges
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import Plant
from twind.robot.arrays import Bools, Floats, Ints
from twind.twin.simulation import hush

NONE = int(mujoco.mjtStage.mjSTAGE_NONE)
VELOCITY = int(mujoco.mjtStage.mjSTAGE_VEL)
# Persistent simulations go on from what the last step computed of its new state: 6 % less for 8 robots. The
# data of more falls out of the processor's cache: 5 % more at 32, and 0.3 MB of memory each.
KEPT = 16
BROKEN = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)


class BatchBody:
    """`count` robots of one plant, each by itself. One Python thread may use it at a time."""

    def __init__(
        self, plant: Plant, ranges: RandomisationRanges, period: float, count: int, threads: int | None
    ) -> None:
        """`ranges`: what differs from episode to episode; `threads`: None, as many as there are cores."""
        hush()
        self.plant = plant
        self.count = count
        cores = len(os.sched_getaffinity(0)) if threads is None else threads
        threads = max(1, min(cores, count))
        self.batch: Any = Batch(plant.model, count, threads, persistent=count <= KEPT)
        n = len(plant.default)
        links = plant.links
        self._draws = DrawSampler(ranges, n, len(links), links)
        self._drawn = BatchModelWriter(PhysicsRandomiser(ranges, plant.model, plant.places), self.batch)
        self._delay: Any = self.batch.expand("sensor_delay") if ranges.imu_delay != ZERO else None
        self._pushes = PushSchedule(ranges.pushes, plant.mass, period, count)
        self._histories = DelayHistories(plant.model)
        self._start = EpisodeStart(plant.model, plant.places, plant.stance)
        self.reading = BodyReading.empty(n, (count,))
        self.diverged: Bools = np.zeros(
            count, np.bool_
        )  # in the last period: what the reading says is of no use
        bind = self.batch.bind
        self._state = bind("qpos"), bind("qvel"), bind("sensordata")
        self._ctrl = bind("ctrl")
        self._history = bind("history")
        self._broken = self.batch.warning[:, BROKEN, 1]
        self._force = bind("xfrc_applied")[:, plant.places.base, :2]
        self._picture: CameraRenderer | None = None

    def reset(self, ids: Ints, rngs: Sequence[np.random.Generator]) -> None:
        """Robots `ids` (sorted) stand in the default pose, changed as drawn from theirs of all the `rngs`."""
        plant = self.plant
        batch = self.batch
        draws = [self._draws.draw(rngs[each]) for each in ids]
        self._drawn.apply(ids, draws)
        batch.reset(ids, stage=NONE)
        qpos, qvel, sensors = self._state
        for each, draw in zip(ids, draws, strict=True):
            qpos[each], qvel[each] = self._start.state(draw)
            self._histories.fill_controls(self._history[each], plant.control)
        self._ctrl[ids] = plant.control
        self._forward(ids)
        rest = sensors[ids]  # a copy
        for each, row in zip(ids, rest, strict=True):
            plant.rest(row)
            self._histories.fill_sensors(self._history[each], row)
        self._pushes.begin(ids, rngs)
        self.diverged[ids] = False
        fresh = BodyReading.empty(len(plant.default), (len(ids),))
        plant.read(qpos[ids], qvel[ids], rest, fresh)
        self.reading.values[ids] = fresh.values

    def advance(self, target: Floats, rngs: Sequence[np.random.Generator]) -> BodyReading:
        """One control period in which the servos go to `target` (count, n), rad.

        The reading (count, …) is the body's own: it changes with the next call.
        """
        self._ctrl[:, self.plant.goals] = target
        if self._pushes.step(rngs):
            self._force[:] = self._pushes.force
        try:
            self.batch.step(nstep=self.plant.substeps, stage=VELOCITY)
        except SimulationError as error:
            self.diverged[error.ids] = True
        if np.count_nonzero(self._broken):  # MuJoCo has put these back to its own start
            self.diverged |= self._broken.any(axis=1)
        self.plant.read(*self._state, self.reading)
        return self.reading

    def picture(self, one: int) -> NDArray[np.uint8]:
        """Robot `one` from the side, (height, width, 3). Raises OperationFailed."""
        model = self.batch.get_model(one)
        data = self.batch.get_data(one)
        mujoco.mj_forward(model, data)
        if self._picture is None:
            self._picture = CameraRenderer(copy.copy(self.plant.model), self.plant.binding.robot.base)
        return self._picture.take(data)

    def close(self) -> None:
        """Give the camera back; may be called twice."""
        if self._picture is not None:
            self._picture.close()
            self._picture = None

    def _forward(self, ids: Ints) -> None:
        """Compute the sensors without their delay, since a reset leaves zeros in their history."""
        if self._delay is None:
            self.batch.forward(ids, stage=VELOCITY)
            return
        delays = self._delay[ids]
        self._delay[ids] = 0.0
        self.batch.forward(ids, stage=VELOCITY)
        self._delay[ids] = delays
