"""Virtual twin of servos of Protocol 1.0: the servos of a robot or of the command line, and their buses.

Runs in `twind-virtual`.
"""

from collections.abc import Sequence
from math import floor

import numpy as np

from twind.config.counts import tick_range
from twind.config.travel import sweep_range
from twind.exceptions import InvalidInput
from twind.virtual.virtual_twin import (
    BenchRequest,
    DeviceOptions,
    EncoderFrame,
    JointDevice,
    RobotBusRequest,
    VirtualBusRequest,
    VirtualTwin,
)
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel1.dynamixel1_identification import derived
from twind_drivers.dynamixel1.dynamixel1_models import model
from twind_drivers.dynamixel1.dynamixel1_registers import baud_of
from twind_drivers.dynamixel1.dynamixel1_type import Dynamixel1Type
from twind_drivers.dynamixel1.virtual_dynamixel1_bus import VirtualDynamixel1Bus
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import FIRMWARE, Dynamixel1ServoSpec, factory_settings
from twind_drivers.half_duplex.checksum_packet import LAST_ID
from twind_drivers.virtual.serial_twin import SERIAL_FAULTS, serial_bus, serial_physics

SPREAD = 200  # counts around the middle where servos of the command line stand


def _common(options: DeviceOptions, baud: int | None) -> dict[str, int]:
    """Return the registers that the command line sets. Raises InvalidInput."""
    delay = options.return_delay_us
    return _baud(baud) | ({} if delay is None else {"return_delay_time": delay // 2})


def _baud(baud: int | None) -> dict[str, int]:
    """Return register 4 for a rate; None: 1 Mbaud. Raises InvalidInput."""
    if baud is None:
        return {}
    codes = [code for code in range(255) if baud_of(code) == baud]
    if not codes:
        raise InvalidInput(f"{baud} baud is no rate of these servos, such as 57600 and 1000000")
    return {"baud_rate": codes[0]}


def robot_devices(request: RobotBusRequest) -> list[tuple[Dynamixel1ServoSpec, EncoderFrame]]:
    """Servos of the joints of a bus, with angle limits around the travel."""
    base = _common(request.options, request.options.baud or request.bus.baud)
    return [_servo_of(each, base, request.options.firmware) for each in request.joints]


def _servo_of(
    device: JointDevice, base: dict[str, int], firmware: int | None
) -> tuple[Dynamixel1ServoSpec, EncoderFrame]:
    joint = device.joint
    kind = joint.type
    assert isinstance(kind, Dynamixel1Type)
    turn = kind.model.turn
    frame = EncoderFrame(1, -round(turn * floor(device.start / turn)))
    low, high = sorted(frame.shown(end) for end in tick_range(joint, device.zero, *sweep_range(joint)))
    last = kind.model.counts - 1
    own = {
        "min_position_limit": max(low, 0),
        "max_position_limit": min(high, last),
        "return_delay_time": kind.return_delay_us // 2,
    }
    settings = own | base | dict(joint.registers) | dict(device.truth.registers)
    return Dynamixel1ServoSpec(
        device.id, kind.device, settings, firmware, volts=kind.volts, hinge=device.hinge
    ), frame


def bench_device(request: BenchRequest) -> Dynamixel1ServoSpec:
    """The servo of `--servo`, as from the factory; its version is the firmware. Raises InvalidInput."""
    id = request.id
    if not (id.isascii() and id.isdigit() and int(id) <= LAST_ID):
        raise InvalidInput(f"--servo {request.text}: id {id} is not one of 0..{LAST_ID}")
    version = request.version
    if version is not None and not (version.isascii() and version.isdigit() and int(version) < 256):
        raise InvalidInput(f"--servo {request.text}: firmware {version} is not one of 0..255")
    settings = _common(request.options, request.options.baud)
    firmware = request.options.firmware if version is None else int(version)
    return Dynamixel1ServoSpec(int(id), request.model, settings, firmware)


def identity(servo: Dynamixel1ServoSpec) -> IdentifiedDevice:
    """Return the identification of a servo, as far as a calibration records it."""
    known = model(servo.model)
    settings = factory_settings(known) | dict(servo.settings)
    firmware = FIRMWARE[known.table] if servo.firmware is None else servo.firmware
    return IdentifiedDevice(servo.id, known.number, known.name, firmware, settings | derived(settings, 0))


def laid_out(
    specs: Sequence[Dynamixel1ServoSpec], seed: int
) -> tuple[Sequence[Dynamixel1ServoSpec], list[float]]:
    """Return servos and their positions (counts), all different, as after placement by hand."""
    random = np.random.default_rng(seed)
    around = random.permutation(np.arange(-SPREAD, SPREAD + 1))[: len(specs)]
    return specs, [
        float(model(each.model).counts // 2 + off) for each, off in zip(specs, around, strict=True)
    ]


def virtual_bus(request: VirtualBusRequest) -> VirtualDynamixel1Bus:
    """Build one bus at the rate of its first servo. Raises InvalidInput for a model not simulated."""
    code = request.devices[0].settings.get("baud_rate") if request.devices else None
    baud = (request.rate or baud_of(1)) if code is None else baud_of(code)
    return serial_bus(VirtualDynamixel1Bus, request, baud)


TWIN = VirtualTwin(
    robot_devices=robot_devices,
    bench_device=bench_device,
    identity=identity,
    physics=serial_physics,
    laid_out=laid_out,
    bus=virtual_bus,
    faults=SERIAL_FAULTS,
    truth_keys=("zero_ticks", "sign", "stops_rad", "friction_nm", "swapped_with", "registers"),
    takes_more=True,
)
