"""Figures of identifications of robots with hidden truth, by seed.

`python -m tests.support.hidden_truth_figures pan-tilt 12 20` prints those of the seeds 12 to 19; with `body`
behind it the truth is the body of virtual servos, else the simulation.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.support.hidden_body import HiddenBodyRig
from tests.support.hidden_robot import goals_of, hide, record
from twind.config.identified_spec import IdentifiedModel, ParameterEstimate
from twind.config.robot_file import RobotFile, load_robot
from twind.gap.gap_figures import JointGap
from twind.gap.motion_samples import MotionSamples
from twind.identification.identified_robot import DataOrigin, RobotIdentification, identify_robot
from twind.identification.servo_parameters import SPREAD, interval
from twind.robot.arrays import Floats
from twind.twin.binding import Binding, bind
from twind.twin.simulation import hush


@dataclass(frozen=True)
class ParameterOutcome:
    """One parameter of one joint against its truth."""

    joint: str
    name: str
    inside: bool  # the truth is in the 95 % interval
    width: float  # of the interval, as a share of the prior's
    miss: float  # in stated deviations


@dataclass(frozen=True)
class HiddenTruthResult:
    """Result of one seed. Gaps (n, 2): share of the spread and of the unexplained, by joint."""

    seed: int
    parameters: list[ParameterOutcome]
    before: Floats
    after: Floats
    robot_seconds: float
    fit_seconds: float  # of CPU time


def judge_seed(robot: RobotFile, seed: int) -> HiddenTruthResult:
    """Return the figures of the robot that `seed` hides, excited from its rest pose."""
    hidden = hide(robot, seed)
    pose = robot.poses.get("ready", robot.poses["rest"])
    goals = goals_of(hidden.binding, np.array([pose[name] for name in robot.names]))
    return _judged(seed, hidden.binding, record(hidden, goals), hidden.truth)


def judge_body(robot: RobotFile, seed: int) -> HiddenTruthResult:
    """Return the figures of the body of virtual servos that `seed` hides, moved by the daemon.

    Its delay is that of bus and servo, which no parameter sets: it is not judged.
    """
    rig = HiddenBodyRig(hide(robot, seed))
    try:
        motion = rig.excite("ready" if "ready" in robot.poses else "rest", 0.4)
        return _judged(seed, rig.one.binding, motion, rig.true_parameters())
    finally:
        rig.close()


def _judged(seed: int, plain: Binding, motion: MotionSamples, truth: IdentifiedModel) -> HiddenTruthResult:
    def rebind(model: IdentifiedModel) -> Binding:
        return bind(replace(plain.robot, identified=model), None)

    begin = time.process_time()
    found = identify_robot(plain, [motion], DataOrigin("2026-11-28T10:00:00Z", "test", "hidden"), rebind)
    spent = time.process_time() - begin
    seconds = float(motion.time[-1] - motion.time[0])
    return HiddenTruthResult(
        seed, judge(found, truth), _gaps(found.before), _gaps(found.after), seconds, spent
    )


def judge(found: RobotIdentification, truth: IdentifiedModel) -> list[ParameterOutcome]:
    """Return the outcome of each parameter of `found`."""
    rows = []
    for joint, each in found.model.joints.items():
        for name, estimate in each.estimates().items():
            low, high = interval(name, estimate.value, estimate.sd)
            true = truth.joints[joint].value(name)
            if true is None:
                continue
            rows.append(
                ParameterOutcome(
                    joint, name, low <= true <= high, _width(name, estimate), _miss(name, estimate, true)
                )
            )
    return rows


def _width(name: str, each: ParameterEstimate) -> float:
    if name in SPREAD and each.determined:
        return (each.sd / each.value) / (each.prior_sd / each.prior)
    return each.sd / each.prior_sd


def _miss(name: str, each: ParameterEstimate, true: float) -> float:
    if name in SPREAD:
        return float(np.log(true / each.value) / (each.sd / each.value))
    return (true - each.value) / each.sd


def _gaps(gaps: Sequence[JointGap]) -> Floats:
    return np.array([(each.position.nrmse_spread, each.position.unexplained) for each in gaps])


def summary(results: Sequence[HiddenTruthResult]) -> str:
    """Return the figures of a group of seeds, and by parameter."""
    rows = [row for each in results for row in each.parameters]
    inside = sum(row.inside for row in rows)
    width = np.array([row.width for row in rows])
    lines = [
        f"inside {inside} of {len(rows)} = {inside / len(rows):.1%}; median interval {np.median(width):.3f}"
    ]
    for norm, title in enumerate(("spread", "unexplained")):
        before = np.concatenate([each.before[:, norm] for each in results])
        after = np.concatenate([each.after[:, norm] for each in results])
        lines.append(
            f"{title}: before median {np.median(before):.3f} worst {before.max():.3f}; "
            f"after median {np.median(after):.4f} worst {after.max():.4f}; "
            f"ratio median {np.median(after / before):.3f} worst {(after / before).max():.3f}"
        )
    lines.append(
        f"robot {max(each.robot_seconds for each in results):.0f} s, "
        f"fit {np.mean([each.fit_seconds for each in results]):.0f} s of CPU"
    )
    for name in dict.fromkeys(row.name for row in rows):
        own = [row for row in rows if row.name == name]
        lines.append(
            f"  {name}: inside {sum(row.inside for row in own)} of {len(own)}, "
            f"median width {np.median([row.width for row in own]):.2f}, "
            f"rms miss {np.sqrt(np.mean([row.miss**2 for row in own])):.2f} sd"
        )
    return "\n".join(lines)


def main() -> None:
    """Print the figures of the seeds of the command line."""
    hush()
    robot = load_robot(sys.argv[1])
    one = judge_body if sys.argv[4:] == ["body"] else judge_seed
    results = []
    for seed in range(int(sys.argv[2]), int(sys.argv[3])):
        results.append(one(robot, seed))
        print(seed, flush=True)
        print(summary(results[-1:]), flush=True)
    print(f"all, {robot.name} seeds {sys.argv[2]} to {int(sys.argv[3]) - 1}")
    print(summary(results))


if __name__ == "__main__":
    main()
