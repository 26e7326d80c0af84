"""The identified model of a robot from its motion: joints, links, and the judgement of the whole body."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twind.command_line.phase_lines import StepReport, no_report
from twind.config.identified_spec import GapReference, IdentifiedJoint, IdentifiedModel
from twind.config.robot_spec import RobotFile
from twind.exceptions import InvalidInput
from twind.gap.gap_figures import JointGap, joint_gaps
from twind.gap.gap_replay import GapReplay
from twind.gap.motion_samples import MotionSamples
from twind.identification.link_masses import link_masses
from twind.identification.motion_windows import LENGTH, is_held_out
from twind.identification.robot_fit import identify_joints
from twind.robot.arrays import Floats
from twind.twin.binding import Binding

SHARE = 0.25  # of the motion that judges the fit


@dataclass(frozen=True, slots=True)
class RobotIdentification:
    """Result of an identification. Gaps are of the whole robot's simulation on held-out motion, by joint."""

    model: IdentifiedModel
    before: Sequence[JointGap]
    after: Sequence[JointGap]
    still: Sequence[str]  # joints that were to be identified and moved too little


@dataclass(frozen=True, slots=True)
class DataOrigin:
    """Date, program and source that an identified model records."""

    created: str
    tool: str
    source: str


def identify_robot(
    plain: Binding,
    motions: Sequence[MotionSamples],
    origin: DataOrigin,
    rebind: Any,
    joints: Sequence[str] | None = None,
    report: StepReport = no_report,
) -> RobotIdentification:
    """Return the identified model of a robot, judged on the held-out part of its motions.

    `plain`: the robot without an overlay; `motions`: even samples of one period; `rebind`: function that
    returns the robot's binding with an IdentifiedModel; `joints`: only these; `report`: gets each
    step. Raises InvalidInput: no joint moved enough.
    """

    def fits(begin: float) -> Callable[[str, float], None]:
        return lambda name, share: report(f"fits {name}", begin + 0.5 * share)

    first = identify_joints(plain, motions, joints, report=fits(0.0))
    if not first:
        raise InvalidInput("no joint moved enough to identify it: each needs some 0.1 rad, several times")
    masses = IdentifiedModel(
        robot=plain.robot.name,
        created=origin.created,
        tool=origin.tool,
        source=origin.source,
        seconds=float(sum(each.time[-1] - each.time[0] for each in motions)),
        held_out=SHARE,
        joints={},
        bodies=link_masses(plain, motions, {name: each.load for name, each in first.items()}),
    )
    # Torques were found as shares of a weight that was fitted too; now of the weight that the model gets.
    found = identify_joints(rebind(masses), motions, joints, first, fits(0.5))
    fitted = {name: each.joint for name, each in found.items()}
    model = replace(masses, joints=with_p_gains(plain.robot, fitted))
    report("simulates the whole robot, before and after", 1.0)
    before = _gaps(plain, motions)
    after = _gaps(rebind(model), motions)
    judged_joints = {each.joint: each for each in after}
    joints_with_gap = {name: _with_gap(each, judged_joints[name]) for name, each in model.joints.items()}
    wanted = plain.robot.names if joints is None else joints
    still = [name for name in wanted if name not in model.joints]
    return RobotIdentification(replace(model, joints=joints_with_gap), before, after, still)


def with_p_gains(robot: RobotFile, joints: Mapping[str, IdentifiedJoint]) -> dict[str, IdentifiedJoint]:
    """Return identified joints by name with the P gains that their servos have, where these are known."""
    gains = {each.name: each.type.p_gain for each in robot.joints if each.type.p_gain > 0.0}
    return {name: replace(joint, p_gain=gains.get(name)) for name, joint in joints.items()}


def _gaps(binding: Binding, motions: Sequence[MotionSamples]) -> list[JointGap]:
    """Return the gap of each joint over the held-out parts of all motions together."""
    replay = GapReplay(binding, motions[0].period)
    return joint_gaps(
        _held_out(motions, motions), _held_out(motions, [replay.simulate(each) for each in motions])
    )


def _held_out(motions: Sequence[MotionSamples], samples: Sequence[MotionSamples]) -> MotionSamples:
    """Return the held-out rows of `samples`, one after the other; they have the rows of `motions`."""
    masks = [is_held_out(np.arange(len(each.time)), round(LENGTH / each.period)) for each in motions]

    def rows(name: str) -> Floats:
        return np.concatenate([getattr(each, name)[mask] for each, mask in zip(samples, masks, strict=True)])

    goal, position, velocity, effort = map(rows, ("goal", "position", "velocity", "effort"))
    time: Floats = motions[0].time[0] + motions[0].period * np.arange(len(goal), dtype=np.float64)
    return MotionSamples(motions[0].names, time, goal, position, velocity, effort)


def _with_gap(joint: IdentifiedJoint, gap: JointGap) -> IdentifiedJoint:
    figure = gap.position
    if figure is None or figure.nrmse_spread is None or figure.unexplained is None:
        return joint
    reference = GapReference(figure.nrmse_spread, figure.unexplained)
    if gap.effort is not None and gap.effort.unexplained is not None:
        reference = replace(reference, effort=gap.effort.unexplained, effort_nm=gap.effort.rms)
    return replace(joint, gap=reference)
