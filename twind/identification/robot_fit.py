"""Fit of all joints of a robot to its recorded motion."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twind.command_line.phase_lines import no_report
from twind.config.counts import rad_per_tick
from twind.config.identified_spec import PARAMETERS, GapReference, IdentifiedJoint, ParameterEstimate
from twind.gap.motion_samples import MotionSamples
from twind.identification.joint_fit import JointFit, fit_joint
from twind.identification.joint_loads import joint_loads
from twind.identification.link_weights import LARGEST, SPRING, LinkWeights, link_weights
from twind.identification.motion_windows import JointWindows, join_windows, windows_of, with_cable
from twind.identification.servo_parameters import FITTED, LOAD, ServoPriors, priors_of
from twind.identification.servo_response import respond
from twind.robot.arrays import Floats
from twind.twin.binding import Binding
from twind.twin.servo_effects import servo_rows

DELAYS = np.arange(0.0, 0.081, 0.005)  # s, at which the goal is tried as the simplest model
LEAST = 3  # windows with motion, for a fit
UNLIMITED = 0.25  # rad: error of full torque that is assumed of a servo whose model has no torque limit


@dataclass(frozen=True, slots=True)
class IdentifiedServo:
    """Result for one joint: the estimates, and the gap on held-out windows with the prior and with them."""

    joint: IdentifiedJoint
    load: ParameterEstimate  # weight behind the joint, as a share of the model's
    before: GapReference
    after: GapReference


def identify_joints(
    binding: Binding,
    motions: Sequence[MotionSamples],
    joints: Sequence[str] | None = None,
    earlier: Mapping[str, IdentifiedServo] | None = None,
    report: Callable[[str, float], None] = no_report,
) -> dict[str, IdentifiedServo]:
    """Return the identified joints by name; those that move too little are left out.

    `motions`: even samples of one period, as `resample` makes them. `joints`: only these. `earlier`: results
    from which these begin; the weight behind the joints then is that of `binding`. Joints with no more weight
    than a cable pulls keep them: of what acts like weight there, no mass is the cause. `report`: gets each
    joint's name and the share that is done.
    """
    weights = link_weights(binding, motions)
    loads = [joint_loads(binding, each.time, each.position) for each in motions]
    found = {}
    chosen = [name for name in binding.robot.names if joints is None or name in joints]
    for place, name in enumerate(binding.robot.names):
        if name not in chosen:
            continue
        report(name, chosen.index(name) / len(chosen))
        priors = model_priors(binding, place, weights)
        if earlier is not None and name in earlier and priors.sd[FITTED.index(LOAD)] >= LARGEST:
            found[name] = earlier[name]
            continue
        passive = float(binding.model.dof_damping[binding.dof[place]])
        parts = [
            windows_of(each.time, sent_goals(binding, each.goal), each.position, load, place, passive)
            for each, load in zip(motions, loads, strict=True)
        ]
        moved = [part for part in parts if part is not None]
        windows = join_windows(moved) if moved else None
        if windows is not None and windows.held_out.any() and (~windows.held_out).sum() >= LEAST:
            found[name] = _identify(windows, priors, None if earlier is None else earlier[name].joint)
    return found


def sent_goals(binding: Binding, goal: Floats) -> Floats:
    """Return goals (t, n), rad, as the bus carries them: whole counts, where no transmission is between."""
    counts = [0.0 if each.transmission else abs(rad_per_tick(each)) for each in binding.robot.joints]
    width = np.array(counts)
    return np.where(width > 0.0, np.round(goal / np.maximum(width, 1e-9)) * width, goal)


def model_priors(binding: Binding, place: int, weights: LinkWeights | None = None) -> ServoPriors:
    """Return the priors of a joint from the model's servo and hinge, as they are without an overlay.

    `weights`: along the motion, where the weight behind the joint is fitted.
    """
    model = binding.model
    dof = binding.dof[place]
    row = int(servo_rows(model, binding.actuators[place : place + 1])[0])
    known = {
        "stiffness_nm_per_rad": float(model.actuator_gainprm[row, 0]),
        "damping_nm_s_per_rad": float(model.dof_damping[dof] - model.actuator_biasprm[row, 2]),
        "friction_nm": float(model.dof_frictionloss[dof]),
        "armature_kg_m2": float(model.dof_armature[dof]),
    }
    identified = binding.robot.identified
    before = None if identified is None else identified.joints.get(binding.robot.names[place])
    given = {} if before is None else before.estimates()
    known |= {name: given[name].prior for name in known if name in given}
    limited = bool(model.actuator_forcelimited[row])
    reach = float(model.actuator_forcerange[row, 1] / model.actuator_gainprm[row, 0])
    stall = known["stiffness_nm_per_rad"] * (reach if limited else UNLIMITED)
    least = {"damping_nm_s_per_rad": 0.01 * stall, "friction_nm": 0.01 * stall, "armature_kg_m2": 1e-4}
    known |= {key: max(known[key], value) for key, value in least.items()}
    fixed = {} if weights is None else {LOAD: (1.0, weights.uncertainty(place, stall))}
    return priors_of(known, stall, **fixed)


def _identify(windows: JointWindows, priors: ServoPriors, earlier: IdentifiedJoint | None) -> IdentifiedServo:
    fitted = windows.chosen(~windows.held_out)
    pulled = with_cable(windows, SPRING * priors.stall_nm).chosen(~windows.held_out)

    def errors(values: Floats) -> Floats:
        return _errors(fitted, priors, values)

    def disturbed(values: Floats) -> Floats:
        return _errors(pulled, priors, values)

    if earlier is None:
        fit = fit_joint(errors, priors, disturbed=disturbed)
    else:
        start = np.array([*(each.value for each in earlier.estimates().values()), 1.0])
        fit = fit_joint(errors, priors, start=start, held=np.array(FITTED) == LOAD, disturbed=disturbed)
    estimates = estimates_of(fit, priors)
    load = estimates.pop(LOAD)
    before = _gap(windows, priors, priors.mean)
    after = _gap(windows, priors, fit.values)
    return IdentifiedServo(IdentifiedJoint(**estimates, p_gain=None, gap=after), load, before, after)


def _errors(windows: JointWindows, priors: ServoPriors, values: Floats) -> Floats:
    return respond(windows.windows, values, priors.saturation_rad)[:, windows.rows] - windows.measured


def _gap(windows: JointWindows, priors: ServoPriors, values: Floats) -> GapReference:
    """Return the gap on the windows that took no part in the fit."""
    judged = windows.held_out
    error = _rms(_errors(windows, priors, values[None])[0][:, judged])
    measured = windows.measured[:, judged]
    spacing = windows.windows.step
    shifts = [round(delay / spacing) for delay in DELAYS]
    rows = windows.windows.lead + windows.rows
    alone = min(_rms(windows.windows.goal[rows - shift][:, judged] - measured) for shift in shifts)
    return GapReference(error / max(float(np.std(measured)), 1e-9), error / max(alone, 1e-9))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def estimates_of(fit: JointFit, priors: ServoPriors) -> dict[str, ParameterEstimate]:
    """Return the estimates of `FITTED` by name."""
    names = (*PARAMETERS, LOAD)
    columns = (fit.values, fit.sd, priors.mean, priors.sd)
    rows = zip(*(column.tolist() for column in columns), fit.determined.tolist(), strict=True)
    return {name: ParameterEstimate(*row) for name, row in zip(names, rows, strict=True)}
