"""Fit of all joints of a robot to its recorded motion."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twind.config.identified_spec import PARAMETERS, GapReference, IdentifiedJoint, ParameterEstimate
from twind.identification.joint_fit import JointFit, fit_joint
from twind.identification.joint_loads import joint_loads
from twind.identification.motion_windows import JointWindows, windows_of
from twind.identification.servo_parameters import LOAD, ServoPriors, priors_of
from twind.identification.servo_response import respond
from twind.robot.arrays import Floats
from twind.twin.binding import Binding
from twind.twin.servo_effects import servo_rows

DELAYS = np.arange(0.0, 0.081, 0.005)  # s, at which the goal is tried as the simplest model


@dataclass(frozen=True, slots=True)
class IdentifiedServo:
    """Result for one joint: the estimates, and the gap on held-out windows with the prior and with them."""

    joint: IdentifiedJoint
    load: ParameterEstimate  # weight and inertia behind the joint, as a share of the model's
    before: GapReference
    after: GapReference


def identify_joints(
    binding: Binding, time: Floats, goal: Floats, position: Floats
) -> Mapping[str, IdentifiedServo]:
    """Return the identified joints by name; those that move too little are left out.

    `time` (t,) s, even; `goal`, `position` (t, n) rad, in joint order.
    """
    loads = joint_loads(binding, time, position)
    found = {}
    for place, name in enumerate(binding.robot.names):
        passive = float(binding.model.dof_damping[binding.dof[place]])
        windows = windows_of(time, goal, position, loads, place, passive)
        if windows is not None:
            found[name] = _identify(windows, model_priors(binding, place))
    return found


def model_priors(binding: Binding, place: int) -> ServoPriors:
    """Return the priors of a joint from the model's servo and hinge."""
    model = binding.model
    dof = binding.dof[place]
    row = int(servo_rows(model, binding.actuators[place : place + 1])[0])
    limited = bool(model.actuator_forcelimited[row])
    stall = float(model.actuator_forcerange[row, 1]) if limited else float(binding.limits.effort[place])
    known = {
        "stiffness_nm_per_rad": float(model.actuator_gainprm[row, 0]),
        "damping_nm_s_per_rad": float(model.dof_damping[dof] - model.actuator_biasprm[row, 2]),
        "friction_nm": float(model.dof_frictionloss[dof]),
        "armature_kg_m2": float(model.dof_armature[dof]),
    }
    least = {"damping_nm_s_per_rad": 0.01 * stall, "friction_nm": 0.01 * stall, "armature_kg_m2": 1e-4}
    known |= {key: max(known[key], value) for key, value in least.items()}
    return priors_of(known, stall)


def _identify(windows: JointWindows, priors: ServoPriors) -> IdentifiedServo:
    def errors(values: Floats) -> Floats:
        return _errors(windows, priors, values)[:, :, ~windows.held_out]

    fit = fit_joint(errors, priors)
    estimates = estimates_of(fit, priors)
    load = estimates.pop(LOAD)
    before = _gap(windows, priors, priors.mean)
    after = _gap(windows, priors, fit.values)
    return IdentifiedServo(IdentifiedJoint(**estimates, gap=after), load, before, after)


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
