"""Response of single joints to their goals: many windows and many candidates of parameters at once.

Only the joint's own servo, friction and inertia are simulated. What the rest of the robot does to it comes
from the measured motion (`joint_loads.py`). Follows `twind/twin/servo_effects.py`, so that a fit holds there.
"""

from dataclasses import dataclass

import numpy as np

from twind.identification.servo_parameters import FITTED
from twind.robot.arrays import Floats
from twind.twin.servo_effects import LEAST_SUPPLY, STRIBECK_SPEED


@dataclass(frozen=True, slots=True)
class ResponseWindows:
    """Windows of the motion of one joint. Arrays over steps are (t, w) at spacing `step`, others (w,)."""

    step: float  # s
    goal: Floats  # (lead + t, w) rad: the first rows are before the windows begin
    lead: int
    gain: Floats  # (w,): stiffness as a share of the nominal one, from the P gain of the recording
    torque_on: Floats  # (t, w): 0.0 while the servo is off
    inertia: Floats  # kg·m², of the links, without armature
    bias: Floats  # N·m against the motion at the measured angle: gravity, other joints
    slope: Floats  # N·m/rad, of `bias` by the joint's angle
    measured: Floats  # rad, where `bias` was evaluated
    swing: Floats  # (w,) N·m: weight times lever of a pendulum that hangs at angle zero
    start: Floats  # rad, reading at the begin
    speed: Floats  # rad/s
    side: Floats  # -1..1: where in its play the encoder is behind the joint
    passive: float  # N·m·s/rad, damping that acts without torque too


@dataclass(frozen=True, slots=True)
class _DampingTerms:
    """Terms of a step that depend on the damping alone: (c, 1), or (c, w) where some servos are off."""

    braking: Floats  # N·m·s/rad
    servo: Floats  # N·m·s/rad, the part that the servo makes
    impulse: Floats  # N·m·s²/rad, of one step

    @classmethod
    def of(cls, braking: Floats, passive: float, step: float) -> "_DampingTerms":
        return cls(braking, np.maximum(braking - passive, 0.0), step * braking)


def respond(windows: ResponseWindows, values: Floats, saturation_rad: float) -> Floats:
    """Return the readings (c, t, w), rad, of candidates `values` (c, p) in the order of `FITTED`."""
    columns = {name: values[:, place, None] for place, name in enumerate(FITTED)}
    half_play = columns["backlash_rad"] / 2.0
    half_dead = columns["dead_band_rad"] / 2.0
    stiffness = columns["stiffness_nm_per_rad"] * windows.gain
    most = columns["stiffness_nm_per_rad"] * saturation_rad
    damping = columns["damping_nm_s_per_rad"]
    load = columns["load_scale"]
    stribeck, dry = columns["stribeck_nm"], columns["friction_nm"]
    load_friction, sag = columns["load_friction_per_nm"], columns["sag_per_nm"]
    armature = columns["armature_kg_m2"]
    goals = _delayed(windows, columns["delay_s"])
    step = windows.step
    limp = np.minimum(damping, windows.passive)
    pendulum = bool(windows.swing.any())
    off = np.asarray(~(windows.torque_on > 0.0).all(axis=1))
    plain = _DampingTerms.of(damping, windows.passive, step)
    shown = np.broadcast_to(windows.start, stiffness.shape).copy()
    angle = shown + half_play * windows.side
    speed = np.broadcast_to(windows.speed, stiffness.shape).copy()
    torque = np.zeros_like(shown)
    out = np.empty((len(values), *windows.bias.shape))
    for at in range(len(windows.bias)):
        out[:, at] = shown
        error = goals[at] - angle
        error -= np.minimum(np.maximum(error, -half_dead), half_dead)
        error *= stiffness
        supply = np.maximum(1.0 - sag * np.abs(torque), LEAST_SUPPLY)
        drive = np.minimum(np.maximum(error, -most), most) * supply * windows.torque_on[at]
        bias = windows.bias[at] + windows.slope[at] * (angle - windows.measured[at])
        if pendulum:
            bias += windows.swing * np.sin(angle)
        bias *= load
        inertia = windows.inertia[at] + armature
        terms = plain
        if off[at]:
            terms = _DampingTerms.of(
                np.where(windows.torque_on[at] > 0.0, damping, limp), windows.passive, step
            )
        torque = drive - terms.servo * speed
        friction = stribeck * np.exp(-((speed / STRIBECK_SPEED) ** 2))
        friction += dry
        friction += load_friction * (drive - terms.braking * speed + bias) ** 2
        friction *= step
        heavy = inertia + terms.impulse
        free = (inertia * speed + step * (drive - bias)) / heavy
        speed = np.copysign(np.maximum(np.abs(free) - friction / heavy, 0.0), free)
        angle = angle + step * speed
        shown = np.minimum(np.maximum(shown, angle - half_play), angle + half_play)
    return out


def _delayed(windows: ResponseWindows, delay: Floats) -> Floats:
    """Return the goals (t, c, w) that act in each step; each is held from when it was sent."""
    steps = np.clip(delay[:, 0] / windows.step, 0.0, windows.lead - 1.0)
    whole = steps.astype(np.int64)
    share = (steps - whole)[:, None]
    rows = windows.lead + np.arange(len(windows.bias))[:, None] - whole
    return np.asarray((1.0 - share) * windows.goal[rows] + share * windows.goal[rows - 1])
