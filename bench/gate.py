"""`gate.check_1000x24`: a thousand waypoints of all joints through every rule of the curve.

`gate.lookahead_100`: a hundred waypoints swept for clearance, all joints moving.
"""

from collections.abc import Mapping
from functools import partial

import mujoco
import numpy as np

from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    as_in_the_loop,
    cpu_per_call,
    interleaved,
    medians,
    spread,
)
from twind.config.robot_file import load_robot
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.joint_limits import JointLimits
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.splines import interpolate
from twind.robot.trajectory import Reference, Trajectory
from twind.safety import gate
from twind.safety.headroom import JointCondition
from twind.twin.binding import bind
from twind.twin.collision_model import CollisionModel
from twind.twin.curve_sweep import CurveSweep, SweepResult

# s
POINTS = 1000
SPAN = 20.0
WAYPOINTS = 100
CALLS = 100


def take() -> Mapping[str, MeasuredFigure]:
    """CPU time of one whole verdict, for each degree of interpolant; the slowest is the figure."""
    binding = bind(load_robot("h24"), None)
    limits = binding.limits
    whole = _path(limits)
    paths = {
        "linear": Trajectory(whole.time, whole.position, whole.commanded),
        "cubic": Trajectory(whole.time, whole.position, whole.commanded, whole.velocity),
        "quintic": whole,
    }
    snapshot = _snapshot(whole, binding.ratings)
    thresholds = gate.GateThresholds()

    def judged(path: Trajectory) -> float:
        return cpu_per_call(lambda _: judge(path), CALLS) * 1e3

    def judge(path: Trajectory) -> None:
        refusals = gate.check(path, snapshot, limits, gate.TrajectoryRequest(), thresholds).verdict.refusals
        if refusals:
            raise RuntimeError(f"the path was refused: {refusals[0]}")

    with as_in_the_loop():
        found = interleaved(ROUNDS, {name: partial(judged, path) for name, path in paths.items()})
    middle = medians(found)
    worst = max(middle, key=middle.__getitem__)
    each = ", ".join(f"{name} {value:.2f}" for name, value in middle.items())
    note = f"accepted, all rules in one go; slowest of {each} ms; {spread(found[worst], 'ms')}"
    return {"gate.check_1000x24": MeasuredFigure(middle[worst], note)}


def _path(limits: JointLimits) -> Trajectory:
    """All joints from a third to two thirds of their range and back twice, at rest at both ends."""
    time = np.linspace(0.0, SPAN, POINTS)
    s = time / SPAN
    turns = 2.0 * 2.0 * np.pi  # two whole waves along a smooth run of the phase
    phase = turns * (10 * s**3 - 15 * s**4 + 6 * s**5)
    speed = turns * (30 * s**2 - 60 * s**3 + 30 * s**4) / SPAN
    gain = turns * (60 * s - 180 * s**2 + 120 * s**3) / SPAN**2
    wide = (limits.upper - limits.lower) / 6.0
    middle = (limits.upper + limits.lower) / 2.0
    return Trajectory(
        time,
        middle - np.cos(phase)[:, None] * wide,
        np.ones(len(wide), np.bool_),
        (np.sin(phase) * speed)[:, None] * wide,
        (np.cos(phase) * speed**2 + np.sin(phase) * gain)[:, None] * wide,
    )


def _snapshot(path: Trajectory, ratings: ActuatorRatings) -> gate.GateSnapshot:
    """Armed, holding where the path begins, all well."""
    n = path.position.shape[1]
    return gate.GateSnapshot(
        now=5.0,
        mode=Mode.LIVE,
        state=RobotState.ARMED,
        motion=Motion.HOLDING,
        latched=(),
        lease_held=True,
        mismatches=(),
        calibrated=np.ones(n, np.bool_),
        age=np.full(n, 0.004),
        latency=0.006,
        latency_p95=0.007,
        reference=Reference(path.position[0], np.zeros(n), np.zeros(n)),
        period=0.01,
        condition=JointCondition(np.full(n, 35.0), np.full(n, 12.0), np.full(n, 0.1), ratings),
    )


def look() -> Mapping[str, MeasuredFigure]:
    """CPU time of one sweep, proved between the waypoints, and of kinematics and collision there alone."""
    binding = bind(load_robot("h24"), None)
    path = _gentle(binding.limits)
    bodies = CollisionModel(binding)
    still = np.zeros(len(binding.rest))
    curve = interpolate(path, Reference(path.position[0], still, still))
    model = binding.model
    data = mujoco.MjData(binding.model)
    poses = path.position
    qpos = data.qpos

    def sweep() -> SweepResult:
        steps = CurveSweep(bodies).running(curve)
        while True:
            try:
                next(steps)
            except StopIteration as stop:
                swept: SweepResult = stop.value
                return swept

    def bare() -> None:
        for pose in poses:
            qpos[:] = pose
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)

    found = sweep()
    if found.refused or found.unfinished:
        raise RuntimeError(f"the path was refused: {found}")
    takes = {
        "sweep": lambda: cpu_per_call(lambda _: sweep(), CALLS) * 1e3,
        "bare": lambda: cpu_per_call(lambda _: bare(), CALLS) * 1e3,
    }
    with as_in_the_loop():
        rounds = interleaved(ROUNDS, takes)
    middle = medians(rounds)
    note = f"{len(bodies.pairs)} pairs, {found.work} poses and measurements; {spread(rounds['sweep'], 'ms')}"
    peers = {"bare kinematics + collision loop": middle["bare"]}
    return {"gate.lookahead_100": MeasuredFigure(middle["sweep"], note, peers)}


def _gentle(limits: JointLimits) -> Trajectory:
    """Waypoints 20 ms apart: every joint there and back within a tenth of its range, from a clear pose."""
    time = np.linspace(0.0, 2.0, WAYPOINTS + 1)[1:]
    wave = 0.5 - 0.5 * np.cos(np.pi * time)
    wide = 0.05 * (limits.upper - limits.lower)
    start = np.clip(np.zeros(len(wide)), limits.lower + wide, limits.upper - wide)
    return Trajectory(time, start + wave[:, None] * wide, np.ones(len(wide), np.bool_))


MEASUREMENTS = (
    Measurement({"gate.check_1000x24": FigureSpec("ms", "≤ 1")}, take),
    Measurement({"gate.lookahead_100": FigureSpec("ms", "≤ 2, ≤ 2 × bare")}, look),
)
