"""`gate.check_1000x24`: a thousand waypoints of all joints through every rule of the curve."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from bench.harness import (
    ROUNDS,
    Figure,
    Key,
    Measurement,
    as_in_the_loop,
    cpu_per_call,
    interleaved,
    medians,
    spread,
)
from twind.config.robot_file import load_robot
from twind.robot.limits import Limits
from twind.robot.modes import Mode, Motion, State
from twind.robot.trajectory import Reference, Trajectory
from twind.safety import gate
from twind.twin.binding import bind

POINTS, SPAN = 1000, 20.0  # s
CALLS = 100


def take() -> Mapping[str, Figure]:
    """CPU time of one whole verdict, for each degree of interpolant; the slowest is the figure."""
    limits = bind(load_robot("h24"), None).limits
    whole = _path(limits)
    paths = {
        "linear": Trajectory(whole.time, whole.position, whole.commanded),
        "cubic": Trajectory(whole.time, whole.position, whole.commanded, whole.velocity),
        "quintic": whole,
    }
    snapshot, thresholds = _snapshot(whole), gate.Thresholds()

    def judged(path: Trajectory) -> float:
        return cpu_per_call(lambda _: judge(path), CALLS) * 1e3

    def judge(path: Trajectory) -> None:
        refusals = gate.check(path, snapshot, limits, gate.Demand(), thresholds).verdict.refusals
        if refusals:
            raise RuntimeError(f"the path was refused: {refusals[0]}")

    with as_in_the_loop():
        found = interleaved(ROUNDS, {name: partial(judged, path) for name, path in paths.items()})
    middle = medians(found)
    worst = max(middle, key=middle.__getitem__)
    each = ", ".join(f"{name} {value:.2f}" for name, value in middle.items())
    note = f"accepted, all rules S05–S22 in one go; slowest of {each} ms; {spread(found[worst], 'ms')}"
    return {"gate.check_1000x24": Figure(middle[worst], note)}


def _path(limits: Limits) -> Trajectory:
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


def _snapshot(path: Trajectory) -> gate.Snapshot:
    """Armed, holding where the path begins, all well."""
    n = path.position.shape[1]
    return gate.Snapshot(
        now=5.0,
        mode=Mode.LIVE,
        state=State.ARMED,
        motion=Motion.HOLDING,
        latched=(),
        lease_held=True,
        mismatches=(),
        calibrated=np.ones(n, np.bool_),
        age=np.full(n, 0.004),
        latency=0.006,
        latency_p95=0.007,
        reference=Reference(path.position[0], np.zeros(n), np.zeros(n)),
    )


MEASUREMENTS = (Measurement({"gate.check_1000x24": Key("ms", "≤ 1")}, take),)
