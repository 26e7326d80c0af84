"""Take-over of torque before the robot is lowered: it holds where it is, and all but limp joints get goals.

Torque that was found on, watchdogs that tripped, and buses that were lost and are back. A joint that cannot
be held without a step gets no goal.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from math import isfinite

import numpy as np

from twind.loop.bus.bus_wait import all_of
from twind.loop.bus.script_run import ScriptRun
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Steps
from twind.loop.procedures.torque_readback import found_limp, torque_on
from twind.loop.procedures.torque_switching import beyond_hard_limit, error_text, joint_names, joints_of, take
from twind.robot.arrays import Bools, Floats, some, spread_over_groups
from twind.robot.finding import Finding, ReasonCode
from twind_drivers.bus import TRIPPED, BusError, DeviceRefused, NoReply, PortError

# s to wait for the turn of a joint; s, the age of a reading that makes the wait worthwhile
KNOWN = 0.5
RECENT = 0.1


def take_over(
    context: ProcedureContext, unjudged: Callable[[], Bools], whole: bool
) -> Generator[None, float, bool]:
    """Hold the robot, or take over torque that was found on or whose watchdog tripped.

    False: it has no torque, was being energised, or cannot be held; then there is nothing to lower.
    `unjudged`: joints (n,) whose turn is not determined yet. `whole`: every joint is taken over, or BusError.
    """
    torque = context.torque
    held = context.hardware.energised_joints
    well = held & (context.hardware.slow.watchdog != TRIPPED)
    if torque.armed and torque.soft_since is not None:
        return True  # it sinks: to clear tripped watchdogs would restore its stiffness
    if torque.armed and some(held) and np.array_equal(well, held):
        yield from _rejoin(context)
        return True
    if torque.energising or not torque_on(context):
        return False
    yield from _wait_for_turns(context, unjudged)
    if not torque.armed:
        torque.leave_limp(found_limp(context))
    here, located = _where_it_is(context)
    stepped = beyond_hard_limit(context) & ~torque.limp
    # A joint that holds well goes on: a goal at its measured position would make it sag. A limp one is
    # prepared, and not at all beyond its hard limit.
    if torque.armed and context.robot.written is not None:
        limp = (context.hardware.slow.torque == 0) & located
        here = np.where(well & ~limp, context.robot.written, here)
        located = (located | well) & ~(limp & stepped)
        stepped = stepped & ~well
    located = located & ~torque.limp
    unknown = ~located & ~torque.limp
    whole = whole and not torque.armed
    if some(stepped):
        remedy = "torque goes off where the robot stands; support it"
        _leave_out(context, stepped, ReasonCode.OUT_OF_LIMIT, _step_text(context, stepped), remedy, whole)
        return False
    if some(unknown):
        # a goal could be a turn away
        message = f"the position of {joint_names(context, unknown)} is unknown"
        remedy = "it gets no goal, and torque goes off where it stands; support it"
        _leave_out(context, unknown, ReasonCode.CALIB_MISMATCH, message, remedy, whole)
    # Where one actuator of a transmission is limp, the others would turn its joints away from the pose.
    located = located & ~spread_over_groups(torque.limp, context.robot.joints.transmission_groups)
    if not some(located):
        return False
    yield from _prepare(context, here, located, whole)
    take(context, here)
    return True


def _prepare(context: ProcedureContext, here: Floats, located: Bools, whole: bool) -> Steps:
    """Clear watchdogs with goal := `here` (n,), rad.

    A write is not acknowledged, so a device that holds another value gets it once more; one that refuses it
    again is left out, with those of its transmission: alone they would turn its joints. Raises BusError; of
    single devices and of a lost bus only where all are needed.
    """
    context.executor.idle()
    context.hardware.clear()
    refusing = np.zeros_like(located)
    while (error := (yield from _gravest(context.hardware.prepare(here, located)))) is not None:
        if whole or not isinstance(error, DeviceRefused | NoReply | PortError):
            raise error
        if not isinstance(error, DeviceRefused):  # the other devices took it over
            _say_not_lowered(context, error)
            return
        device = joints_of(context, error.port, (error.id,)) & located
        left = located & ~spread_over_groups(device & refusing, context.robot.joints.transmission_groups)
        if not some(device) or not some(left):
            raise error
        if some(left != located):
            _say_not_lowered(context, error)
        located = left
        refusing |= device


def _gravest(tasks: Sequence[ScriptRun[None]]) -> Generator[None, float, Exception | None]:
    """Wait for all tasks; return an error other than silence first, as a bus with such a one is not prepared.

    None: there is no error.
    """
    with suppress(BusError, KeyError, ValueError):
        yield from all_of(tasks)
    errors = [task.error for task in tasks if task.error is not None]
    return min(errors, key=lambda each: isinstance(each, NoReply | PortError), default=None)


def _leave_out(
    context: ProcedureContext, left: Bools, code: ReasonCode, message: str, remedy: str, whole: bool
) -> None:
    """Report that joints (n,) get no goal. Raises BusError where the whole robot is wanted."""
    if whole:
        raise BusError(message)
    joint = int(np.flatnonzero(left)[0])
    value = float(context.robot.measured.position[joint])
    found = Finding(code, joint, value=value if isfinite(value) else None, message=message)
    context.reports.event("error", code, f"{message}: {remedy}", (found,))


def _step_text(context: ProcedureContext, stepped: Bools) -> str:
    """Return why joints (n,) past their hard limits are not taken over."""
    return f"to hold {joint_names(context, stepped)} inside the hard limits would be a step"


def _say_not_lowered(context: ProcedureContext, error: BusError) -> None:
    """Report devices that are not lowered: to lower the others is better than to drop the robot."""
    refused = isinstance(error, DeviceRefused)
    did = "refused" if refused else "did not answer"
    message = f"lowered although a device {did}: {error_text(context, error)}"
    context.reports.event("error", ReasonCode.BUS_ERRORS if refused else ReasonCode.DEVICE_MISSING, message)


def _wait_for_turns(context: ProcedureContext, unjudged: Callable[[], Bools]) -> Steps:
    """Wait at most `KNOWN` s for the turn check of joints that answered within the last `RECENT` s.

    Such joints are still unchecked when the daemon has just begun.
    """
    until = context.clock.now() + KNOWN
    while some(unjudged() & (context.robot.measured.age <= RECENT)) and context.clock.now() < until:
        yield


def _rejoin(context: ProcedureContext) -> Steps:
    """Take over a bus that was lost and is back at its present positions; the others hold their goals."""
    hardware = context.hardware
    robot = context.robot
    if (hardware.energised_joints | context.torque.limp).all():
        return
    wanted = ~context.torque.limp
    while context.executor.reference is not None and context.executor.reference.velocity[wanted].any():
        yield  # the joints that are held brake
    back_with = wanted & ~hardware.energised_joints & hardware.open & beyond_hard_limit(context)
    if some(back_with):
        message = f"not taken over, torque goes off where it stands: {_step_text(context, back_with)}"
        context.reports.event("error", ReasonCode.OUT_OF_LIMIT, message)
        return
    here, located = _where_it_is(context)
    back = hardware.prepare_back(here, located & wanted)
    try:
        yield from all_of(back)
    except NoReply as error:
        _say_not_lowered(context, error)
    except BusError as error:  # never a reason to drop the joints that are held
        message = f"not taken over, torque goes off where it stands: {error_text(context, error)}"
        context.reports.event("error", ReasonCode.BUS_ERRORS, message)
        return
    if back and robot.written is not None:
        place = np.where(hardware.energised_joints, robot.written, here)
        hardware.hold(True)
        context.torque.regain_bus(hardware.energised_joints)
        context.executor.begin(place)
        robot.restart(place)


def _where_it_is(context: ProcedureContext) -> tuple[Floats, Bools]:
    """Return where to hold from (n,), as measured, as near as a goal may be; and which places are known.

    The rest pose stands for joints that never answered, or whose turn is unknown: it is not sent to them.
    """
    position = context.robot.measured.position
    finite = np.isfinite(position)
    return context.hardware.reachable(np.where(finite, position, context.robot.rest)), finite
