"""Virtual twin of XL-320 and PRO -R: the servos of a robot or of the command line, and their buses.

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
from twind_drivers.dynamixel.packet import LAST_ID
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.dynamixel2_unwatched.unwatched_identification import derived
from twind_drivers.dynamixel2_unwatched.unwatched_models import model
from twind_drivers.dynamixel2_unwatched.unwatched_servo_type import UnwatchedServoType
from twind_drivers.dynamixel2_unwatched.virtual_unwatched_bus import VirtualUnwatchedBus
from twind_drivers.dynamixel2_unwatched.virtual_unwatched_servos import BAUDS, FIRMWARE, factory_settings
from twind_drivers.virtual.serial_twin import SERIAL_FAULTS, serial_bus, serial_physics

SPREAD = 0.16  # of a turn around the middle where servos of the command line stand


def _common(options: DeviceOptions, baud: int | None) -> dict[str, int]:
    """Return the registers that the command line sets. Raises InvalidInput."""
    made = {}
    if baud is not None:
        if baud not in BAUDS:
            raise InvalidInput(f"{baud} baud is no rate of these servos: {', '.join(map(str, BAUDS))}")
        made["baud_rate"] = BAUDS.index(baud)
    if options.return_delay_us is not None:
        made["return_delay_time"] = options.return_delay_us // 2
    return made


def robot_devices(request: RobotBusRequest) -> list[tuple[Dynamixel1ServoSpec, EncoderFrame]]:
    """Servos of the joints of a bus, with position limits around the travel."""
    base = _common(request.options, request.options.baud or request.bus.baud)
    return [_servo_of(each, base, request.options.firmware) for each in request.joints]


def _servo_of(
    device: JointDevice, base: dict[str, int], firmware: int | None
) -> tuple[Dynamixel1ServoSpec, EncoderFrame]:
    joint = device.joint
    kind = joint.type
    assert isinstance(kind, UnwatchedServoType)
    own = kind.model
    frame = EncoderFrame(1, -round(own.turn * floor((device.start - own.lowest) / own.turn)))
    low, high = sorted(frame.shown(end) for end in tick_range(joint, device.zero, *sweep_range(joint)))
    limits = {
        "min_position_limit": max(low, own.lowest),
        "max_position_limit": min(high, own.highest),
        "return_delay_time": kind.return_delay_us // 2,
    }
    settings = limits | base | dict(joint.registers) | dict(device.truth.registers)
    spec = Dynamixel1ServoSpec(
        device.id, kind.device, settings, firmware, volts=kind.volts, hinge=device.hinge
    )
    return spec, frame


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
    return Dynamixel1ServoSpec(int(id), model(request.model).name, settings, firmware)


def identity(servo: Dynamixel1ServoSpec) -> IdentifiedDevice:
    """Return the identification of a servo, as far as a calibration records it."""
    own = model(servo.model)
    settings = factory_settings(own.table, own.lowest, own.highest) | dict(servo.settings)
    firmware = FIRMWARE if servo.firmware is None else servo.firmware
    return IdentifiedDevice(servo.id, own.number, own.name, firmware, derived(settings))


def laid_out(
    specs: Sequence[Dynamixel1ServoSpec], seed: int
) -> tuple[Sequence[Dynamixel1ServoSpec], list[float]]:
    """Return servos and their positions (counts), all different, as after placement by hand."""
    shares = np.random.default_rng(seed).permutation(np.linspace(-SPREAD, SPREAD, 64))[: len(specs)]
    own = [model(each.model) for each in specs]
    middles = [(each.lowest + each.highest + 1) // 2 for each in own]
    pairs = zip(own, middles, shares.tolist(), strict=True)
    return specs, [float(round(middle + share * each.turn)) for each, middle, share in pairs]


def virtual_bus(request: VirtualBusRequest) -> VirtualUnwatchedBus:
    """Build one bus at the rate of its first servo. Raises InvalidInput for models of two tables."""
    tables = {model(each.model).table for each in request.devices}
    if len(tables) > 1:
        raise InvalidInput(f"bus {request.name}: XL-320 and PRO -R have different registers")
    code = request.devices[0].settings.get("baud_rate") if request.devices else None
    baud = (request.rate or 1_000_000) if code is None else BAUDS[code]
    return serial_bus(VirtualUnwatchedBus, request, baud)


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
