"""Pattern of a walk: feet, centre of mass and weight on each foot over time, for a commanded velocity. Pure.

The centre of mass moves as a linear inverted pendulum of constant height. Its divergent component (capture
point) is planned backwards over the next footsteps, so that the centre of pressure stays under the supporting
foot (Englsberger, Ott, Albu-Schaeffer, "Three-Dimensional Bipedal Walking Control Based on Divergent
Component of Motion", IEEE T-RO 31, 2015).
Places are in the world frame of the start: x forward, y left, m; headings in rad. Foot 0 is the left one.
"""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from twind.robot.arrays import Floats

GRAVITY = 9.81  # m/s²
PREVIEW = 4  # steps ahead that the capture point is planned over
RISE = 0.1  # share of the double support, before its end, in which the rear foot may leave the floor
LANDING = 0.95  # share of the swing after which the foot is down
STANDING_STILL = 1e-6  # m/s, rad/s: a command below it means to stand
SIDE = (1.0, -1.0)  # of the left and the right foot, along y


@dataclass(frozen=True, slots=True)
class GaitSettings:
    """Times and sizes of a gait; the defaults suit servos that accelerate by 80 rad/s²."""

    step_s: float = 0.8
    double_support: float = 0.25  # share of a step in which the weight moves to the next foot
    lift_m: float = 0.02
    inset_m: float = 0.004  # of the centre of pressure, from the middle of the sole towards the other foot
    acceleration: float = 0.1  # m/s², rad/s² by two: how fast the velocity follows its command


@dataclass(frozen=True, slots=True)
class FootPose:
    """Middle of a sole on the floor, m (2,), and its heading, rad."""

    place: Floats
    heading: float

    def towards(self, offset: Floats) -> Floats:
        """Return the place (2,) at `offset` (2,), m, in the axes of the foot."""
        return self.place + rotation(self.heading) @ offset


@dataclass(frozen=True, slots=True)
class GaitTarget:
    """Targets of feet and centre of mass at one time."""

    feet: tuple[FootPose, FootPose]
    lift: tuple[float, float]  # m above the floor
    mass: Floats  # centre of mass (2,), m
    pressure: Floats  # centre of pressure (2,), m
    weight: tuple[float, float]  # share of the weight on each foot
    swing: int | None  # foot in the air


class GaitPhase(Enum):
    """Phases of a walk."""

    STANDING = "standing"
    SHIFTING = "shifting"  # the weight goes to the first supporting foot
    STEPPING = "stepping"
    SETTLING = "settling"  # the weight goes back between the feet


class GaitPattern:
    """Walks from rest to rest; `advance` is called once a control period."""

    def __init__(
        self, settings: GaitSettings, feet: tuple[FootPose, FootPose], mass: Floats, height: float
    ) -> None:
        """`feet`: where they stand; `mass` (2,): centre of mass, m; `height`: of it above the floor, m."""
        self.phase = GaitPhase.STANDING
        self.steps = 0  # taken so far
        self._settings = settings
        self._rate = math.sqrt(GRAVITY / height)  # 1/s, of the pendulum
        self._feet = list(feet)
        self._half = 0.5 * abs(float(feet[0].place[1] - feet[1].place[1]))
        self._mass = np.array(mass, np.float64)
        self._pressure = self._mass.copy()
        self._velocity = np.zeros(3)
        self._time = 0.0  # s, in the present phase
        self._support = 1  # foot that carries; the left one takes the first step
        self._begin_rest()

    @property
    def velocity(self) -> Floats:
        """Present velocity (3,): forward, left, m/s, and turn, rad/s."""
        return self._velocity.copy()

    def advance(self, period: float, command: Floats) -> GaitTarget:
        """Return the target after `period` s.

        `command` (3,): forward, left, m/s; turn, rad/s; zeros: stop and stand.
        """
        most = self._settings.acceleration * period * np.array([1.0, 1.0, 2.0])
        self._velocity += np.clip(command - self._velocity, -most, most)
        if self.phase is GaitPhase.STANDING and np.abs(command).max() > STANDING_STILL:
            self._begin_shift()
        if self.phase is not GaitPhase.STANDING:
            self._time += period
            if self._time >= self._duration:
                self._time -= self._duration
                self._end_phase(command)
        return self._target(period)

    # ------------------------------------------------------------------------------------------ phases

    def _begin_rest(self) -> None:
        self.phase = GaitPhase.STANDING
        self._swing: int | None = None
        self._from = self._to = self._feet[self._support]
        self._begin_pressure = self._pressure.copy()
        self._end_pressure = self._pressure.copy()
        self._duration = self._transfer = math.inf

    def _begin_shift(self) -> None:
        self.phase = GaitPhase.SHIFTING
        self._begin_phase(None, self._anchor(self._feet[self._support], self._support), 1.2, 0.9)
        self._plan(self._support)

    def _begin_step(self) -> None:
        self.phase = GaitPhase.STEPPING
        swing = 1 - self._support
        self._begin_phase(
            swing, self._anchor(self._feet[self._support], self._support), 1.0, self._settings.double_support
        )
        self._from = self._feet[swing]
        self._to = self._landing(swing, self._feet[self._support])
        self._plan(swing)

    def _begin_settling(self) -> None:
        self.phase = GaitPhase.SETTLING
        anchors = [self._anchor(foot, side) for side, foot in enumerate(self._feet)]
        self._begin_phase(None, 0.5 * (anchors[0] + anchors[1]), 1.5, 0.8)
        self._capture_end = self._end_pressure.copy()

    def _begin_phase(self, swing: int | None, pressure: Floats, duration: float, transfer: float) -> None:
        """`duration`, `transfer`: of the phase and of the weight's way to `pressure`, in step times."""
        self._swing = swing
        self._begin_pressure = self._end_pressure
        self._end_pressure = pressure
        self._duration = duration * self._settings.step_s
        self._transfer = transfer * self._settings.step_s

    def _end_phase(self, command: Floats) -> None:
        if self.phase is GaitPhase.SETTLING:
            self._begin_rest()
            return
        parallel = True
        if self._swing is not None:
            landed = self._to
            parallel = np.allclose(
                self._landing(self._swing, self._feet[self._support], still=True).place,
                landed.place,
                atol=1e-3,
            )
            self._feet[self._swing] = landed
            self._support = self._swing
            self.steps += 1
        if np.abs(command).max() <= STANDING_STILL and parallel and self._swing is not None:
            self._begin_settling()
        else:
            self._begin_step()

    # ------------------------------------------------------------------------------------------ places

    def _anchor(self, foot: FootPose, side: int) -> Floats:
        """Return the centre of pressure (2,) of a foot that carries all."""
        return foot.towards(np.array([0.0, -SIDE[side] * self._settings.inset_m]))

    def _landing(self, side: int, support: FootPose, *, still: bool = False) -> FootPose:
        """Return where foot `side` lands beside `support`, at the present velocity or at none."""
        forward, left, turn = (np.zeros(3) if still else self._velocity * self._settings.step_s).tolist()
        heading = support.heading + turn
        middle = support.towards(np.array([forward, SIDE[side] * self._half + left]))
        return FootPose(middle + rotation(heading) @ np.array([0.0, SIDE[side] * self._half]), heading)

    def _plan(self, following: int) -> None:
        """Work out the capture point at the end of this phase; `following`: foot that carries then."""
        feet = list(self._feet)
        if self._swing is not None:
            feet[self._swing] = self._to
        anchors = []
        for _ in range(PREVIEW):
            anchors.append(self._anchor(feet[following], following))
            feet[1 - following] = self._landing(1 - following, feet[following])
            following = 1 - following
        capture = 0.5 * (anchors[-1] + anchors[-2])
        transfer = self._settings.double_support * self._settings.step_s
        before = [self._end_pressure, *anchors[:-1]]
        for begin, end in zip(reversed(before), reversed(anchors), strict=True):
            held = end + (capture - end) * math.exp(-self._rate * (self._settings.step_s - transfer))
            capture = self._through_transfer(begin, end, held, transfer)
        self._capture_end = capture

    def _through_transfer(self, begin: Floats, end: Floats, capture: Floats, duration: float) -> Floats:
        """Return the capture point (2,) `duration` s before it is `capture`.

        Meanwhile the pressure goes from `begin` to `end` at a steady speed.
        """
        speed = (end - begin) / (duration * self._rate)
        found: Floats = begin + speed + (capture - end - speed) * math.exp(-self._rate * duration)
        return found

    # ------------------------------------------------------------------------------------------ targets

    def _target(self, period: float) -> GaitTarget:
        share = min(self._time / self._transfer, 1.0)
        pressure = self._begin_pressure + (self._end_pressure - self._begin_pressure) * share
        if self.phase is not GaitPhase.STANDING:
            self._mass = self._mass + period * self._rate * (self._capture(pressure, share) - self._mass)
        self._pressure = pressure
        feet = list(self._feet)
        lift = [0.0, 0.0]
        if self._swing is not None:
            feet[self._swing], lift[self._swing] = self._swinging()
        weight = self._weight(feet, pressure, share)
        airborne = self._swing if share >= 1.0 else None
        return GaitTarget(
            (feet[0], feet[1]), (lift[0], lift[1]), self._mass.copy(), pressure, weight, airborne
        )

    def _capture(self, pressure: Floats, share: float) -> Floats:
        """Return the capture point (2,) now, from the one at the end of the phase."""
        if share >= 1.0:
            rest = math.exp(-self._rate * (self._duration - self._time))
            return self._end_pressure + (self._capture_end - self._end_pressure) * rest
        held = math.exp(-self._rate * (self._duration - self._transfer))
        capture = self._end_pressure + (self._capture_end - self._end_pressure) * held
        return self._through_transfer(pressure, self._end_pressure, capture, self._transfer - self._time)

    def _swinging(self) -> tuple[FootPose, float]:
        """Return pose and lift of the swinging foot: at rest at both ends."""
        start = (1.0 - RISE) * self._transfer
        share = min(max((self._time - start) / (self._duration - start) / LANDING, 0.0), 1.0)
        way = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        place = self._from.place + (self._to.place - self._from.place) * way
        heading = self._from.heading + (self._to.heading - self._from.heading) * way
        lift = 16.0 * self._settings.lift_m * (share * (1.0 - share)) ** 2
        return FootPose(place, heading), lift

    def _weight(self, feet: list[FootPose], pressure: Floats, share: float) -> tuple[float, float]:
        """Return the share of the weight on each foot."""
        if self._swing is not None and share >= 1.0:
            return (1.0, 0.0) if self._support == 0 else (0.0, 1.0)
        left, right = (self._anchor(foot, side) for side, foot in enumerate(feet))
        span = left - right
        on_left = float(np.clip((pressure - right) @ span / (span @ span), 0.0, 1.0))
        return on_left, 1.0 - on_left


def rotation(heading: float) -> Floats:
    """Return the rotation (2, 2) by `heading`, rad."""
    cosine = math.cos(heading)
    sine = math.sin(heading)
    return np.array([[cosine, -sine], [sine, cosine]])
