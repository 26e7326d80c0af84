"""Reading of `ros2_control` sections and `<transmission>` elements of a URDF, as plain records.

Each driver has its own names for port and baud. In `dynamixel_hardware_interface` a `<gpio>` stands for each
servo. Rows of `transmission_to_joint_matrix` assign servos to joints (its README, "Hardware Configuration").
"""

from collections.abc import Mapping

from twind_calibration.model_import.imported_model import HardwareJoint, HardwareSystem, RemarkList
from twind_calibration.model_import.xml_tree import XmlElement

PORTS = ("port_name", "usb_port", "serial_port", "port", "device", "device_name")
BAUDS = ("baud_rate", "baudrate", "baud")
IDS = ("id", "servo_id", "motor_id", "dxl_id")
MODELS = ("model", "model_name", "servo_model", "motor_model")
MATRIX = "transmission_to_joint_matrix"

Gear = tuple[float | None, float | None]  # reduction, offset


def read_hardware(robot: XmlElement, remarks: RemarkList) -> tuple[HardwareSystem, ...]:
    """All sections of a robot. Raises InvalidInput."""
    gears = _gears(robot)
    return tuple(_system(section, gears, remarks) for section in robot.all("ros2_control"))


def _system(section: XmlElement, outside: Mapping[str, Gear], remarks: RemarkList) -> HardwareSystem:
    hardware = section.first("hardware") or XmlElement("hardware", {}, section.place)
    parameters = _parameters(hardware)
    plugin = hardware.first("plugin")
    gears = {**outside, **_gears(section)}
    joints = section.all("joint")
    servos = [gpio for gpio in section.all("gpio") if _pick(_parameters(gpio), IDS) is not None]
    weights = _matrix(parameters, len(joints), len(servos))
    found = []
    for row, joint in enumerate(joints):
        driving = [(servo, weight) for servo, weight in zip(servos, weights[row], strict=True) if weight]
        if len(driving) > 1:
            names = ", ".join(servo.required("name") for servo, _ in driving)
            remarks.add(
                joint.place, f"joint {joint.required('name')!r} is driven by {names}: a linkage, not read"
            )
        found.append(_joint(joint, driving[0] if len(driving) == 1 else None, gears, remarks))
    return HardwareSystem(
        name=section.attributes.get("name", ""),
        plugin="" if plugin is None else plugin.text.strip(),
        port=_pick(parameters, PORTS),
        baud=_whole(_pick(parameters, BAUDS), hardware, "baud rate"),
        parameters=parameters,
        joints=tuple(found),
        place=section.place,
    )


def _joint(
    joint: XmlElement,
    driving: tuple[XmlElement, float] | None,
    gears: Mapping[str, Gear],
    remarks: RemarkList,
) -> HardwareJoint:
    name = joint.required("name")
    elements = [joint] if driving is None else [joint, driving[0]]
    parameters = {key: value for element in elements for key, value in _parameters(element).items()}
    reduction, offset = gears.get(name, (None, None))
    if driving is not None and driving[1] != 1.0 and reduction is None:
        reduction = 1.0 / driving[1]
        remarks.add(joint.place, f"joint {name!r}: reduction {reduction:g} from {MATRIX}")
    return HardwareJoint(
        joint=name,
        device=elements[-1].required("name"),
        id=_whole(_pick(parameters, IDS), elements[-1], "id"),
        model=_pick(parameters, MODELS),
        commands=tuple(
            command.required("name") for element in elements for command in element.all("command_interface")
        ),
        parameters=parameters,
        reduction=reduction,
        offset=offset,
        place=joint.place,
    )


def _parameters(element: XmlElement) -> dict[str, str]:
    return {each.required("name"): " ".join(each.text.split()) for each in element.all("param")}


def _pick(parameters: Mapping[str, str], names: tuple[str, ...]) -> str | None:
    """Value of the first of these names, in any case; None where there is none."""
    lower = {key.lower(): value for key, value in parameters.items()}
    return next((lower[name] for name in names if lower.get(name)), None)


def _whole(text: str | None, element: XmlElement, thing: str) -> int | None:
    if text is None:
        return None
    if not (text.isascii() and text.isdecimal() and len(text) <= 9):
        raise element.refused(f"{thing} {text[:40]!r} is no whole number from 0; correct it")
    return int(text)


def _matrix(parameters: Mapping[str, str], joints: int, servos: int) -> list[list[float]]:
    """Row of weights of the servos for each joint; without a matrix, the servo in the same place."""
    words = parameters.get(MATRIX, "").replace(",", " ").split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != joints * servos:
        values = [float(row == column) for row in range(joints) for column in range(servos)]
    return [values[row * servos : (row + 1) * servos] for row in range(joints)]


def _gears(parent: XmlElement) -> dict[str, Gear]:
    """Reduction and offset of each joint that a `<transmission>` of one joint names."""
    found: dict[str, Gear] = {}
    for transmission in parent.all("transmission"):
        joints = transmission.all("joint")
        if len(joints) == 1:
            parts = [*joints, *transmission.all("actuator")]
            reductions = [_value(part, ("mechanical_reduction", "mechanicalReduction")) for part in parts]
            product = 1.0
            for reduction in reductions:
                product *= 1.0 if reduction is None else reduction
            given = any(reduction is not None for reduction in reductions)
            found[joints[0].required("name")] = (product if given else None, _value(joints[0], ("offset",)))
    return found


def _value(element: XmlElement, tags: tuple[str, ...]) -> float | None:
    for tag in tags:
        child = element.first(tag)
        if child is not None:
            return XmlElement(tag, {"value": child.text.strip()}, child.place).number("value")
    return None
