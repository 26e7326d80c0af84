"""Facts from an imported model: limits, speeds, and the ids and models of its `ros2_control` section."""

import math
from collections.abc import Iterable
from difflib import get_close_matches

from twind.command_line.verb import Rejected
from twind_calibration.drafting.mapping_file import bus_name
from twind_calibration.drafting.robot_draft import RobotDraft
from twind_calibration.model_import.imported_model import HardwareSystem, ImportedModel
from twind_calibration.model_import.ros2_control_reader import IDS, MODELS

# rad between the stops of a model and the limits: a limp joint rests on its stop, and must be armed there.
MARGIN = 0.03
MOST_SPEED = 100.0  # rad/s that a robot file takes


def fill_from_hardware(draft: RobotDraft, model: ImportedModel) -> None:
    """State ids, models, gears and buses of every `ros2_control` section."""
    for system in model.hardware:
        bus = bus_name(system.port or system.name)
        if system.port:
            draft.bus(bus).state("port", system.port, system.place)
        if system.baud:
            draft.bus(bus).state("baud", system.baud, system.place)
        _state_devices(draft, system, bus)
        draft.remarks.extend(_unread(system))


def fill_from_model(draft: RobotDraft, model: ImportedModel) -> tuple[str, ...]:
    """State limits and speeds of the model's joints; return the joints that have no motor.

    Raises Rejected: a joint of another source is no hinge of the model, or no source names a motor.
    """
    hinges = {joint.name: joint for joint in model.joints if joint.kind == "hinge"}
    for facts in draft.joints.values():
        name = facts.get("model_joint", facts.name)
        if name not in hinges:
            kind = next((joint.kind for joint in model.joints if joint.name == name), None)
            near = [] if kind else get_close_matches(name, hinges, 1)
            remedy = "" if kind else f"say --joint {facts.name}=NAME, or "
            raise Rejected(
                f"joint {facts.name} ({facts.source('id') or 'no id'}) is "
                f"{f'a {kind}, no hinge,' if kind else 'no hinge'} of {model.file.name}"
                f"{f'; nearest: {near[0]}' if near else ''}; {remedy}leave it out (--without {facts.name})"
            )
        joint = hinges[name]
        if joint.range is not None:
            facts.state("lower", joint.range[0] + MARGIN, joint.place)
            facts.state("upper", joint.range[1] - MARGIN, joint.place)
        if joint.velocity is not None and 0.0 < joint.velocity < MOST_SPEED:
            facts.state("velocity", joint.velocity, joint.place)
    if not draft.joints:
        raise Rejected(
            f"{model.file.name} has joints, but no source has ids: add --port BUS=PORT or --from FILE"
        )
    driven = {facts.get("model_joint", facts.name) for facts in draft.joints.values()}
    passive = tuple(joint.name for joint in model.joints if joint.name not in driven)
    draft.remarks.extend(f"joint {name} of the model has no motor: passive" for name in passive)
    draft.remarks.extend(f"{remark.place}: {remark.text}" for remark in model.remarks)
    return passive


def _unread(system: HardwareSystem) -> Iterable[str]:
    """Yield one remark with the parameters of joints and servos that become no fact."""
    known = {"type", *IDS, *MODELS}
    names = {name: None for joint in system.joints for name in joint.parameters if name.lower() not in known}
    if names:
        yield f"{system.place}: not read: {', '.join(names)}"


def _state_devices(draft: RobotDraft, system: HardwareSystem, bus: str) -> None:
    for each in system.joints:
        facts = draft.joint(each.joint)
        facts.state("bus", bus, each.place)
        if each.id is not None:
            facts.state("id", each.id, each.place)
        if each.model:
            facts.state("device", each.model, each.place)
        if each.reduction:
            facts.state("ratio", abs(each.reduction), each.place)
            facts.state("sign", int(math.copysign(1, each.reduction)), each.place)
        if each.offset:
            draft.remarks.append(f"{each.place}: offset {each.offset:g} rad is left to the calibration")
