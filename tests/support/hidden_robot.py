"""A simulated robot with hidden parameters, and two effects that no identified model has.

The effects: a cable that pulls each joint like a spring, and cogging, a torque that changes with the angle.
"""

from dataclasses import dataclass, replace

import numpy as np

from twind.config.identified_spec import IdentifiedBody, IdentifiedJoint, IdentifiedModel, ParameterEstimate
from twind.config.robot_file import RobotFile
from twind.gap.motion_samples import MotionSamples
from twind.identification.excitation import RATE, ExcitationBounds, excite
from twind.identification.robot_fit import model_priors, sent_goals
from twind.identification.servo_parameters import FITTED
from twind.robot.arrays import Floats
from twind.twin.binding import Binding, bind
from twind.twin.simulation import Simulation

PERIOD = 0.01
ENCODER = 2.0 * np.pi / 4096.0
CABLE = 0.03  # N·m/rad of a cable, as a share of the stall torque, at most
COGGING = 0.3  # torque, as a share of the friction, at most
WAVE = 24.0  # per turn
# Ranges: of the logarithm of the prior's mean, of a share of it, and of values.
LOGARITHMS = {
    "stiffness_nm_per_rad": 0.35,
    "damping_nm_s_per_rad": 0.6,
    "friction_nm": 0.8,
    "armature_kg_m2": 0.45,
}
SHARES = {"stribeck_nm": 2.5, "load_friction_per_nm": 2.5, "sag_per_nm": 2.0}
VALUES = {"delay_s": (0.002, 0.025), "dead_band_rad": (0.0, 0.008), "backlash_rad": (0.0, 0.015)}
MASS = (0.85, 1.18)


@dataclass(frozen=True)
class HiddenRobot:
    """The robot file that the fit may know, its hidden parameters, and the simulation that has them."""

    binding: Binding  # without the truth
    truth: IdentifiedModel
    hidden: Binding
    cable: Floats  # N·m/rad
    cogging: Floats  # N·m


def hide(robot: RobotFile, seed: int) -> HiddenRobot:
    """Return a robot whose parameters are drawn by `seed`."""
    rng = np.random.default_rng(seed)
    binding = bind(robot, None)
    joints = {}
    stall = []
    for place, name in enumerate(robot.names):
        priors = model_priors(binding, place)
        mean = dict(zip(FITTED, priors.mean.tolist(), strict=True))
        stall.append(priors.saturation_rad * mean["stiffness_nm_per_rad"])
        drawn = {key: mean[key] * np.exp(rng.uniform(-most, most)) for key, most in LOGARITHMS.items()}
        drawn |= {key: mean[key] * rng.uniform(0.0, most) for key, most in SHARES.items()}
        drawn |= {key: rng.uniform(*bounds) for key, bounds in VALUES.items()}
        estimates = {key: ParameterEstimate(value, 0.0, mean[key], 0.0) for key, value in drawn.items()}
        joints[name] = IdentifiedJoint(**estimates)
    bodies = {}
    for number in range(1, binding.model.nbody):
        body = binding.model.body(number)
        mass = float(body.mass[0])
        drawn_mass = ParameterEstimate(mass * rng.uniform(*MASS), 0.0, mass, 0.0)
        bodies[body.name] = IdentifiedBody(mass_kg=drawn_mass)
    truth = IdentifiedModel(robot.name, "2026-11-28T10:00:00Z", "test", "hidden", 0.0, 0.0, joints, bodies)
    count = len(robot.names)
    friction = np.array([each.value("friction_nm") or 0.0 for each in joints.values()])
    return HiddenRobot(
        binding,
        truth,
        bind(replace(robot, identified=truth), None),
        np.array(stall) * rng.uniform(0.3, 1.0, count) * CABLE,
        rng.uniform(0.3, 1.0, count) * COGGING * friction,
    )


def goals_of(binding: Binding, rest: Floats, spread: float = 1.0) -> Floats:
    """Return goals (t, n) at `PERIOD`: each joint alone, then all together."""
    limits = binding.limits
    bounds = [
        ExcitationBounds(
            *(
                float(column[at])
                for column in (limits.lower, limits.upper, limits.velocity, limits.acceleration)
            )
        )
        for at in range(len(rest))
    ]
    alone = [excite(rest[at], bounds[at], 0.5 * spread) for at in range(len(rest))]
    rows = []
    for at, column in enumerate(alone):
        table = np.tile(rest, (len(column), 1))
        table[:, at] = column
        rows.append(table)
    both = [excite(rest[at], bounds[at], 0.3 * spread, at / len(rest)) for at in range(len(rest))]
    table = np.tile(rest, (max(map(len, both)), 1))
    for at, column in enumerate(both):
        table[: len(column), at] = column
    points = np.concatenate([*rows, table])
    time = np.arange(0.0, (len(points) - 1) / RATE, PERIOD)
    sent = np.arange(len(points)) / RATE
    return np.stack([np.interp(time, sent, points[:, at]) for at in range(len(rest))], axis=-1)


def record(robot: HiddenRobot, goals: Floats, unmodelled: bool = True) -> MotionSamples:
    """Return the motion of the hidden robot that gets `goals` (t, n), from the first on, in whole counts."""
    simulation = Simulation(robot.hidden, PERIOD / 4.0)
    data, dof = simulation.data, robot.hidden.dof
    simulation.place(goals[0])
    shown = np.empty_like(goals)
    for at, goal in enumerate(sent_goals(robot.binding, goals)):
        shown[at] = simulation.state(0.0).position
        for _ in range(4):
            if unmodelled:
                angle = data.qpos[robot.hidden.qpos]
                data.qfrc_applied[dof] = robot.cogging * np.sin(WAVE * angle) - robot.cable * angle
            simulation.step(goal)
    shown = np.round(shown / ENCODER) * ENCODER
    time = np.arange(len(goals)) * PERIOD
    unknown = np.full_like(shown, np.nan)
    return MotionSamples(
        robot.binding.robot.names, time, goals, shown, np.gradient(shown, PERIOD, axis=0), unknown
    )
