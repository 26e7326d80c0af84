"""Virtual twin of Feetech servos: the servos of a robot or of the command line, and their buses.

Runs in `twind-virtual`.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import floor

import numpy as np

from twind.config.counts import tick_range
from twind.config.travel import sweep_range
from twind.exceptions import InvalidInput
from twind.virtual.virtual_twin import (
    BenchRequest,
    EncoderFrame,
    JointDevice,
    RobotBusRequest,
    VirtualBusRequest,
    VirtualTwin,
)
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.feetech.feetech_models import model
from twind_drivers.feetech.feetech_registers import BAUDS, register_map
from twind_drivers.feetech.feetech_type import MANY, FeetechType
from twind_drivers.feetech.virtual_feetech_bus import VirtualFeetechBus
from twind_drivers.feetech.virtual_feetech_spec import FIRMWARE, FeetechServoSpec
from twind_drivers.half_duplex.checksum_packet import LAST_ID
from twind_drivers.virtual.serial_twin import SERIAL_FAULTS, serial_bus, serial_physics

SPREAD = 200  # counts around the middle where servos of the command line stand
MULTI_TURN = {"phase": 12 | 0x10, "min_position_limit": 0, "max_position_limit": 0}


def _baud(baud: int | None) -> dict[str, int]:
    """Return register 6 for a rate; None: as from the factory. Raises InvalidInput."""
    if baud is None:
        return {}
    if baud not in BAUDS:
        raise InvalidInput(f"{baud} baud is no rate of these servos: {', '.join(map(str, BAUDS))}")
    return {"baud_rate": BAUDS.index(baud)}


def robot_devices(request: RobotBusRequest) -> list[tuple[FeetechServoSpec, EncoderFrame]]:
    """Servos of the joints of a bus, with limits of their own around the travel."""
    base = _baud(request.options.baud or request.bus.baud)
    return [_servo_of(each, base) for each in request.joints]


def _servo_of(device: JointDevice, base: dict[str, int]) -> tuple[FeetechServoSpec, EncoderFrame]:
    joint = device.joint
    kind = joint.type
    assert isinstance(kind, FeetechType)
    truth = device.truth
    offset = truth.homing_offset
    frame = EncoderFrame()
    if joint.mode == MANY:
        own = dict(MULTI_TURN)
    else:
        turn = kind.map.turn
        frame = EncoderFrame(1, -round(offset + turn * floor((device.start - offset) / turn)))
        low, high = sorted(frame.shown(end) for end in tick_range(joint, device.zero, *sweep_range(joint)))
        last = 2 * kind.centre - 1
        own = {"min_position_limit": max(low, 0), "max_position_limit": min(high, last)}
    settings = own | base | dict(joint.registers) | {"homing_offset": offset} | dict(truth.registers)
    spec = FeetechServoSpec(device.id, kind.device, settings, volts=kind.volts, hinge=device.hinge)
    return spec, frame


def bench_device(request: BenchRequest) -> FeetechServoSpec:
    """The servo of `--servo`, as from the factory; its version is MAJOR.MINOR. Raises InvalidInput."""
    id = request.id
    if not (id.isascii() and id.isdigit() and int(id) <= LAST_ID):
        raise InvalidInput(f"--servo {request.text}: id {id} is not one of 0..{LAST_ID}")
    spec = FeetechServoSpec(int(id), request.model, _baud(request.options.baud))
    if request.version is None:
        return spec
    parts = request.version.split(".")
    if len(parts) != 2 or not all(part.isascii() and part.isdigit() and int(part) < 256 for part in parts):
        raise InvalidInput(f"--servo {request.text}: firmware {request.version} is not MAJOR.MINOR")
    end = int(register_map(model(request.model).map).big_endian)
    return replace(spec, firmware=(int(parts[0]), int(parts[1]), end))


def identity(servo: FeetechServoSpec) -> IdentifiedDevice:
    """Return the identification of a servo, as far as a calibration records it."""
    known = model(servo.model)
    major, minor, _ = servo.firmware or FIRMWARE[known.map]
    last = 1023 if register_map(known.map).big_endian else 4095
    settings = {
        "homing_offset": 0,
        "drive_mode": 0,
        "operating_mode": 0,
        "min_position_limit": 0,
        "max_position_limit": last,
    } | dict(servo.settings)
    return IdentifiedDevice(servo.id, known.number, known.name, major * 100 + minor, settings)


def laid_out(specs: Sequence[FeetechServoSpec], seed: int) -> tuple[Sequence[FeetechServoSpec], list[float]]:
    """Return servos and their positions (counts), all different, as after placement by hand."""
    random = np.random.default_rng(seed)
    around = random.permutation(np.arange(-SPREAD, SPREAD + 1))[: len(specs)]
    middle = [512 if register_map(model(each.model).map).big_endian else 2048 for each in specs]
    return specs, [float(own + off) for own, off in zip(middle, around, strict=True)]


def virtual_bus(request: VirtualBusRequest) -> VirtualFeetechBus:
    """Build one bus at the rate of its first servo. Raises InvalidInput for a model not simulated."""
    code = request.devices[0].settings.get("baud_rate") if request.devices else None
    baud = (request.rate or BAUDS[0]) if code is None else BAUDS[code]
    return serial_bus(VirtualFeetechBus, request, baud)


TWIN = VirtualTwin(
    robot_devices=robot_devices,
    bench_device=bench_device,
    identity=identity,
    physics=serial_physics,
    laid_out=laid_out,
    bus=virtual_bus,
    faults=SERIAL_FAULTS,
    truth_keys=(
        "zero_ticks",
        "sign",
        "stops_rad",
        "friction_nm",
        "swapped_with",
        "homing_offset",
        "registers",
    ),
    takes_more=True,
)
