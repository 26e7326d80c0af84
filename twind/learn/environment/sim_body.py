"""The body that is a MuJoCo simulation in this process: one robot, free on the floor."""

import copy
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from twind.learn.randomise.disturbances import PushSchedule
from twind.learn.randomise.episode_start import DelayHistories, EpisodeStart
from twind.learn.randomise.physics_randomiser import PhysicsRandomiser, SingleModelWriter
from twind.learn.randomise.randomisation_ranges import DrawSampler, RandomisationRanges
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import Plant, fill
from twind.robot.arrays import Floats
from twind.twin.simulation import hush

NOTHING: Mapping[str, object] = {}


class SimBody:
    """A `RobotBody`. Between steps the data is as after `mj_step1`: of now."""

    def __init__(self, plant: Plant, ranges: RandomisationRanges, period: float) -> None:
        """`ranges`: what differs from episode to episode; the plant must have room for its delays."""
        hush()
        self.plant = plant
        self.model: Any = copy.copy(plant.model)
        self.data: Any = mujoco.MjData(self.model)
        n = len(plant.default)
        links = plant.links
        self._draws = DrawSampler(ranges, n, len(links), links)
        self._drawn = SingleModelWriter(PhysicsRandomiser(ranges, self.model, plant.places), self.model)
        self._start = EpisodeStart(plant.model, plant.places, plant.stance)
        self._pushed = ranges.pushes is not None
        self._pushes = PushSchedule(ranges.pushes, plant.mass, period)
        self._histories = DelayHistories(self.model)
        self._late = bool(self.model.nhistory)
        self._reading = BodyReading.empty(n)
        self._rngs: list[np.random.Generator] = []
        self._between = plant.substeps - 2
        self._option: Any = self.model.opt
        self._seeing = self._blind = int(self._option.disableflags)
        if not ranges.imu_delay[1]:  # a delayed sensor must be computed at every step
            self._blind |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        self._lasts = period - 0.5 * self.model.opt.timestep
        self._due = 0.0
        d = self.data
        self._state = d.qpos, d.qvel, d.sensordata
        self._steady = plant.steady
        self._parts = plant.parts(*self._state)
        self._goals = plant.goals
        self._ctrl = d.ctrl
        self._force = d.xfrc_applied[plant.places.base, :2]

    @property
    def diverged(self) -> bool:
        """The physics broke down in the last period; MuJoCo has then put the robot back to its own start."""
        return bool(self.data.time < self._due)

    @property
    def step_info(self) -> Mapping[str, object]:
        """Nothing: all is as it was asked."""
        return NOTHING

    def reset(self, rng: np.random.Generator) -> BodyReading:
        """Standing in the default pose, changed as drawn from `rng`, at rest but for what is drawn."""
        plant = self.plant
        data = self.data
        draw = self._draws.draw(rng)
        self._drawn.apply(draw)
        mujoco.mj_resetData(self.model, data)
        data.qpos[:], data.qvel[:] = self._start.state(draw)
        data.ctrl[:] = plant.control
        if self._late:
            self._histories.fill_controls(data.history, data.ctrl)
            delays = self.model.sensor_delay.copy()
            self.model.sensor_delay[:] = 0.0  # else it tells the zeros that a reset leaves in its history
        mujoco.mj_step1(self.model, data)
        plant.rest(data.sensordata)
        if self._late:
            self.model.sensor_delay[:] = delays
            self._histories.fill_sensors(data.history, data.sensordata)
        self._rngs = [rng]
        self._due = 0.0
        self._pushes.begin([0], self._rngs)
        return self._read()

    def advance(self, target: Floats, velocity: Floats) -> BodyReading:
        """One control period in which the servos go to `target` (n,), rad; `velocity` is theirs to find."""
        self._due = self.data.time + self._lasts
        self._ctrl[self._goals] = target
        if self._pushed and self._pushes.step(self._rngs):
            self._force[:] = self._pushes.force[0]
        self._step()
        return self._read()

    def close(self) -> None:
        """Nothing is held."""

    def _step(self) -> None:
        """The physics of one period. Sensors are worked out at its end alone: that saves 4 % of it."""
        model = self.model
        data = self.data
        if self._between >= 0:
            self._option.disableflags = self._blind
            mujoco.mj_step2(model, data)
            if self._between:
                mujoco.mj_step(model, data, self._between)
            mujoco.mj_step1(model, data)
            self._option.disableflags = self._seeing
        mujoco.mj_step2(model, data)
        mujoco.mj_step1(model, data)

    def _read(self) -> BodyReading:
        parts = self._parts if self._steady else self.plant.parts(*self._state)
        fill(self._reading, *parts)
        return self._reading
