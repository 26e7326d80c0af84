"""Fit of one servo to recordings in which it swings a mass on an arm, from rest to the end of each."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twind.config.identified_spec import IdentifiedJoint
from twind.identification.joint_fit import JointFit, fit_joint
from twind.identification.pendulum_recordings import PendulumRecording
from twind.identification.robot_fit import estimates_of
from twind.identification.servo_parameters import ServoPriors, priors_of
from twind.identification.servo_response import ResponseWindows, respond
from twind.robot.arrays import Floats

GRAVITY = 9.80665
STEP = 0.004  # s
LEAD = 12  # steps
SPARSE = 4  # steps for each error of the fit
PASSIVE = 0.125  # share of the damping that acts without torque: friction in oil, no back-EMF


@dataclass(frozen=True, slots=True)
class PendulumServo:
    """Figures of the maker: the priors of a servo on a test bench."""

    stall_nm: float  # at the supply of the recordings
    no_load_rad_s: float
    kp: float  # P gain to which the stiffness refers
    full_error_rad: float  # error at which the drive is at its full voltage, with that gain


# XL330-M288: 0.52 N·m, 103 rev/min at 5 V (e-manual), taken to 7.4 V. Full output (885) stands at
# 885 * 256 / P counts of error: measured from the register of present PWM, in recordings of three gains.
XL330 = PendulumServo(0.77, 16.0, 400.0, 885.0 * 256.0 / 400.0 * math.tau / 4096.0)


def priors_of_pendulum(servo: PendulumServo) -> ServoPriors:
    """Return the priors; mass and arm are known to 2 %."""
    known = {
        "stiffness_nm_per_rad": servo.stall_nm / servo.full_error_rad,
        "damping_nm_s_per_rad": servo.stall_nm / servo.no_load_rad_s,
        "friction_nm": 0.02 * servo.stall_nm,
        "armature_kg_m2": 0.0019,  # fit of Rhoban/bam
    }
    priors = priors_of(known, servo.stall_nm, load_scale=(1.0, 0.02), delay_s=(0.003, 0.003))
    return replace(priors, saturation_rad=servo.full_error_rad)


def fit_pendulum(recordings: Sequence[PendulumRecording], servo: PendulumServo = XL330) -> JointFit:
    """Return the fit of all recordings together."""
    priors = priors_of_pendulum(servo)
    windows, measured = _windows(recordings, servo)

    def errors(values: Floats) -> Floats:
        return (respond(windows, values, priors.saturation_rad) - measured)[:, ::SPARSE]

    return fit_joint(errors, priors, memory=0)


def identified_pendulum(fit: JointFit, servo: PendulumServo = XL330) -> IdentifiedJoint:
    """Return the estimates of a fit, without its load, which is known."""
    estimates: dict[str, Any] = dict(estimates_of(fit, priors_of_pendulum(servo)))
    estimates.pop("load_scale")
    return IdentifiedJoint(**estimates, p_gain=servo.kp)


def replay_error(
    recordings: Sequence[PendulumRecording], values: Floats, servo: PendulumServo = XL330
) -> Floats:
    """Return the mean absolute error of position (r,), rad, of simulations that get only the goals."""
    windows, measured = _windows(recordings, servo)
    shown = respond(windows, values[None], priors_of_pendulum(servo).saturation_rad)[0]
    return np.asarray(np.nanmean(np.abs(shown - measured), axis=0))


def _windows(recordings: Sequence[PendulumRecording], servo: PendulumServo) -> tuple[ResponseWindows, Floats]:
    """Return one window for each recording, and the readings (t, w) at its steps; NaN after its end."""
    count = max(int(each.time[-1] / STEP) for each in recordings)
    time = (np.arange(LEAD + count) - LEAD) * STEP
    goals, on, measured = [], [], []
    for each in recordings:
        held = np.clip(np.searchsorted(each.time, time + STEP / 2.0, side="right") - 1, 0, None)
        goals.append(each.goal[held])
        on.append(each.torque_on[held[LEAD:]])
        measured.append(np.interp(time[LEAD:], each.time, each.position, right=np.nan))
    none = np.zeros((count, len(recordings)))
    mass, length, gain = np.array([(each.mass, each.length, each.kp) for each in recordings]).T
    windows = ResponseWindows(
        step=STEP,
        goal=np.stack(goals, axis=-1),
        lead=LEAD,
        gain=gain / servo.kp,
        torque_on=np.stack(on, axis=-1),
        inertia=none + mass * length**2,
        bias=none,
        slope=none,
        measured=none,
        swing=mass * GRAVITY * length,
        start=np.array([each.position[0] for each in recordings]),
        speed=np.zeros(len(recordings)),
        side=np.zeros(len(recordings)),
        passive=PASSIVE * servo.stall_nm / servo.no_load_rad_s,
    )
    return windows, np.stack(measured, axis=-1)
