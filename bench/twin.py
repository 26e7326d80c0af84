"""`twin.mirror_cpu`: a reading into the model and the model's torque out, beside the bare `mj_inverse`."""

from collections.abc import Mapping

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
from twind.robot.joint_state import JointState
from twind.twin.binding import bind
from twind.twin.mirror import TwinMirror

CALLS = 20_000
POSES = 512


def take() -> Mapping[str, MeasuredFigure]:
    """CPU time of one reading, and of `mj_inverse` alone on the same model at the same poses."""
    binding = bind(load_robot("h24"), None)
    mirror = TwinMirror(binding)
    readings = _readings(binding.limits.lower, binding.limits.upper)

    def mirrored(i: int) -> None:
        mirror.update(readings[i % POSES])
        _ = mirror.position, mirror.effort

    def bare(i: int) -> None:
        mujoco.mj_inverse(mirror.model, mirror.data)

    with as_in_the_loop():
        found = interleaved(
            ROUNDS,
            {
                "twind": lambda: cpu_per_call(mirrored, CALLS) * 1e6,
                "mj_inverse": lambda: cpu_per_call(bare, CALLS) * 1e6,
            },
        )
    if mirror.refused:
        raise RuntimeError(f"{mirror.refused} readings were refused: this was not the way of a reading")
    middle = medians(found)
    note = f"24 joints, a new pose each call, pose and torque copied out; {spread(found['twind'], 'µs')}"
    return {"twin.mirror_cpu": MeasuredFigure(middle["twind"], note, {"mj_inverse": middle["mj_inverse"]})}


def _readings(lower: np.ndarray, upper: np.ndarray) -> list[JointState]:
    """Whole readings at random poses within the limits, the same in every run."""
    random = np.random.default_rng(1)
    none = np.zeros(len(lower))
    all_ = np.ones(len(lower), np.bool_)
    return [
        JointState(
            0.01 * i, random.uniform(lower, upper), random.normal(0.0, 1.0, len(lower)), none, none, all_
        )
        for i in range(POSES)
    ]


MEASUREMENTS = (Measurement({"twin.mirror_cpu": FigureSpec("µs", "≤ 50, ≤ 3 ×")}, take),)
