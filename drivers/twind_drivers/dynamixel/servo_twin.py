"""Virtual twin of serial servos: the servos of a robot or of the command line, and their buses.

Runs in `twind-virtual`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from twind.config.counts import tick_range
from twind.config.robot_spec import JointSpec
from twind.config.travel import sweep_range
from twind.exceptions import InvalidInput
from twind.virtual.fault_commands import REAL, FaultArguments
from twind.virtual.robot_ground_truth import JointGroundTruth
from twind.virtual.virtual_twin import (
    BenchRequest,
    EncoderFrame,
    JointDevice,
    RobotBusRequest,
    VirtualBusRequest,
    VirtualTwin,
)
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.packet import LAST_ID
from twind_drivers.dynamixel.servo_type import ServoType
from twind_drivers.virtual.serial_twin import SERIAL_FAULTS, serial_bus, serial_physics
from twind_drivers.virtual.servo_physics import FirstOrderPhysics
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import BAUDS, ServoSpec, VirtualServos

FIRMWARE = 47
# ticks: where such servos stand, and how far from there
MIDDLE = 2048
SPREAD = 400
PLUGGED = 20_000  # ms before the start, within which they were powered on one by one
FACTORY_BAUD = 57600  # e-manual, "Baud Rate": the default of the X series
# Orders of a bus, as the methods of `SerialBusFaults`.
FAULTS: FaultArguments = {
    **SERIAL_FAULTS,
    "garble": {"on?": bool},
    "sag": {"id": int, "volts": REAL},
    "spike": {"id": int, "celsius": REAL, "seconds": REAL},
}


def settings(baud: int | None, return_delay_us: int | None) -> dict[str, int]:
    """Return these settings as EEPROM registers; None: the factory's. Raises InvalidInput."""
    made = {}
    if baud is not None:
        if baud not in BAUDS:
            raise InvalidInput(f"{baud} baud is no rate of these servos: {', '.join(map(str, BAUDS))}")
        made["baud_rate"] = BAUDS.index(baud)
    if return_delay_us is not None:
        if return_delay_us % 2 or not 0 <= return_delay_us <= 508:
            raise InvalidInput(f"return delay {return_delay_us} us: servos do even numbers from 0 to 508")
        made["return_delay_time"] = return_delay_us // 2
    return made


def robot_devices(request: RobotBusRequest) -> list[tuple[ServoSpec, EncoderFrame]]:
    """Servos of the joints of a bus, with limits of their own around the travel."""
    options = request.options
    base = settings(options.baud or request.bus.baud, options.return_delay_us)
    firmware = FIRMWARE if options.firmware is None else options.firmware
    bare = [servo_of(each, base, firmware) for each in request.joints]
    frames = frames_of(request.bus.name, bare, [each.start for each in request.joints])
    return [
        (fenced(spec, each.joint, each.zero, frame), frame)
        for spec, each, frame in zip(bare, request.joints, frames, strict=True)
    ]


def servo_of(device: JointDevice, base: Mapping[str, int], firmware: int) -> ServoSpec:
    """The servo at a joint, without limits of its own; `base`: registers of all of its bus."""
    joint = device.joint
    truth = device.truth
    assert isinstance(joint.type, ServoType)
    described = {"return_delay_time": joint.type.return_delay_us // 2, "operating_mode": joint.operating_mode}
    return ServoSpec(
        device.id,
        joint.type.device,
        described | dict(base) | dict(joint.registers) | truth.eeprom(),
        firmware if truth.firmware is None else truth.firmware,
        forgets_offset=truth.forgets_offset,
        seam_seed=truth.seam_seed,
        hinge=device.hinge,
        turns=truth.turns,
        backlash=truth.backlash_ticks,
    )


def frames_of(bus: str, specs: Sequence[ServoSpec], start: Sequence[int]) -> list[EncoderFrame]:
    """Return the encoder frames of these servos after a boot there. Raises InvalidInput."""
    asleep = [replace(spec, turns=0, backlash=0.0) for spec in specs]
    try:
        servos = VirtualServos(asleep, FirstOrderPhysics(np.array(start, np.float64)))
    except (KeyError, ValueError, OverflowError) as error:
        raise InvalidInput(f"bus {bus}: {error.args[0]}") from None
    return [
        EncoderFrame(int(way), int(shift)) for way, shift in zip(servos.direction, servos.shift, strict=True)
    ]


def fenced(spec: ServoSpec, joint: JointSpec, zero: int, frame: EncoderFrame) -> ServoSpec:
    """Set the servo's own limits around the travel; as delivered if one turn of registers cannot hold it."""
    ends = tick_range(joint, zero, *sweep_range(joint))
    low, high = sorted(frame.shown(end) for end in ends)
    register = table(number_of(spec.model), spec.firmware)["min_position_limit"]
    if not (register.takes(low) and register.takes(high)):
        return spec
    limits = {"min_position_limit": low, "max_position_limit": high}
    return replace(spec, settings=limits | dict(spec.settings))


def bench_device(request: BenchRequest) -> ServoSpec:
    """The servo of `--servo`, as from the factory but for the options. Raises InvalidInput."""
    options = request.options
    version = request.version or str(FIRMWARE if options.firmware is None else options.firmware)
    id = request.id
    if not (id.isascii() and id.isdigit() and int(id) <= LAST_ID):
        raise InvalidInput(f"--servo {request.text}: id {id} is not one of 0..{LAST_ID}")
    if not (version.isascii() and version.isdigit() and int(version) <= 255):
        raise InvalidInput(f"--servo {request.text}: firmware {version} is not one of 0..255")
    try:
        table(number_of(request.model), int(version))
    except (KeyError, ValueError) as error:
        raise InvalidInput(f"--servo {request.text}: {error.args[0]}") from None
    return ServoSpec(int(id), request.model, settings(options.baud, options.return_delay_us), int(version))


def identity(servo: ServoSpec) -> IdentifiedDevice:
    """Return the identification of a servo, as far as a calibration records it."""
    number = number_of(servo.model)
    registers = table(number, servo.firmware)
    keys = ("homing_offset", "drive_mode", "operating_mode", "min_position_limit", "max_position_limit")
    settings = {key: registers[key].rule.default or 0 for key in keys} | dict(servo.settings)
    return IdentifiedDevice(servo.id, number, registers.model, servo.firmware, settings)


def laid_out(specs: Sequence[ServoSpec], seed: int) -> tuple[list[ServoSpec], list[float]]:
    """Return servos and their positions (ticks), all different, as after placement by hand.

    Else two with one id would send the same bits for ever, and no scan could detect that there are two.
    """
    random = np.random.default_rng(seed)
    count = len(specs)
    ticks = random.permutation(np.arange(MIDDLE - SPREAD, MIDDLE + SPREAD + 1))[:count]
    powered = random.permutation(PLUGGED)[:count] * 1e-3
    laid = [replace(spec, powered=float(since)) for spec, since in zip(specs, powered, strict=True)]
    return laid, ticks.astype(np.float64).tolist()


def virtual_bus(request: VirtualBusRequest) -> VirtualBus:
    """Build one bus at the rate of its first servo. Raises InvalidInput for a model not simulated."""
    set_to = request.devices[0].settings.get("baud_rate") if request.devices else None
    baud = (request.rate or FACTORY_BAUD) if set_to is None else BAUDS[set_to]
    try:
        return serial_bus(VirtualBus, request, baud, sensor=request.sensor)
    except (KeyError, ValueError) as error:
        raise InvalidInput(f"bus {request.name}: {error.args[0]}") from None


def refuse_registers(joint: JointSpec, each: JointGroundTruth) -> None:
    """Raises InvalidInput for registers that the model has not, or that do not take the value."""
    if not each.eeprom():
        return
    registers = table(number_of(joint.type.device))
    for key, value in each.eeprom().items():
        if key not in registers or not registers[key].eeprom:
            raise InvalidInput(f"truth: {joint.name}: {registers.model} has no EEPROM register {key!r}")
        if not registers[key].takes(value):
            low, high = registers[key].bounds
            raise InvalidInput(f"truth: {joint.name}: {key} {value} is outside {low}..{high}")


TWIN = VirtualTwin(
    robot_devices=robot_devices,
    bench_device=bench_device,
    identity=identity,
    physics=serial_physics,
    laid_out=laid_out,
    bus=virtual_bus,
    faults=FAULTS,
    refuse_truth=refuse_registers,
    takes_more=True,
)
