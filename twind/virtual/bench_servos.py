"""Bench servos, named on the command line: without a robot file, or beside those of one.

Runs in `twind-virtual`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from twind.exceptions import InvalidInput
from twind.virtual.can_node_setup import default_node, scattered
from twind_drivers.can.can_keys import MAX_ID, MAX_ODRIVE
from twind_drivers.can.can_models import MODELS
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.packet import LAST_ID
from twind_drivers.virtual.can.can_controller import CanAdapter
from twind_drivers.virtual.can.can_motor_physics import CanMotorPhysics
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.can.virtual_can_bus import VirtualCanBus
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.servable_bus import ServableBus
from twind_drivers.virtual.servo_physics import FirstOrderPhysics, ServoPhysics
from twind_drivers.virtual.virtual_sensor import VirtualSensor
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import BAUDS, ServoSpec

FIRMWARE = 47
# ticks: where such servos stand, and how far from there
MIDDLE = 2048
SPREAD = 400
PLUGGED = 20_000  # ms before the start, within which they were powered on one by one
BITRATE = 1_000_000  # bit/s of a CAN bus
FACTORY_BAUD = 57600  # e-manual, "Baud Rate": the default of the X series
USB = (
    0.001  # s, a frame of full-speed USB: a CAN adapter delivers at this interval, so its reader wakes seldom
)


@dataclass(frozen=True, slots=True)
class BusTiming:
    """Timing of the buses, independent of the devices on them."""

    wire_timing: bool = True
    adapter: SerialAdapter = field(default_factory=SerialAdapter)
    seed: int = 0  # of all that is random


def servo(text: str, *, firmware: int = FIRMWARE) -> tuple[str, ServoSpec | NodeSpec]:
    """Bus and servo, or CAN actuator, of `BUS:ID:MODEL[:FIRMWARE]`, as from the factory.

    Raises InvalidInput.
    """
    parts = text.split(":")
    if not 3 <= len(parts) <= 4 or not all(parts):
        raise InvalidInput(f"--servo {text}: it is BUS:ID:MODEL or BUS:ID:MODEL:FIRMWARE")
    bus, id, model = parts[:3]
    if model in MODELS:
        return bus, _node(text, id, model, len(parts) == 4)
    version = parts[3] if len(parts) == 4 else str(firmware)
    if not (id.isascii() and id.isdigit() and int(id) <= LAST_ID):
        raise InvalidInput(f"--servo {text}: id {id} is not one of 0..{LAST_ID}")
    if not (version.isascii() and version.isdigit() and int(version) <= 255):
        raise InvalidInput(f"--servo {text}: firmware {version} is not one of 0..255")
    try:
        table(number_of(model), int(version))
    except (KeyError, ValueError) as error:
        raise InvalidInput(f"--servo {text}: {error.args[0]}") from None
    return bus, ServoSpec(int(id), model, {}, int(version))


def _node(text: str, id: str, model: str, versioned: bool) -> NodeSpec:
    most = MAX_ODRIVE if MODELS[model].family == "odrive" else MAX_ID
    if not (id.isascii() and id.isdigit() and int(id) <= most):
        raise InvalidInput(f"--servo {text}: id {id} is not one of 0..{most}")
    if versioned:
        raise InvalidInput(f"--servo {text}: a CAN actuator has no firmware to choose: BUS:ID:MODEL")
    return default_node(int(id), model)


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


def bench(
    servos: Sequence[tuple[str, ServoSpec | NodeSpec]],
    line: BusTiming,
    *,
    baud: int | None = None,
    now: float = 0.0,
) -> dict[str, ServableBus]:
    """Make buses with these servos alone, joints without load. `baud` of their registers; None: factory.

    Raises InvalidInput for a model that cannot be simulated, and for servos and CAN actuators on one bus.
    """
    buses: dict[str, ServableBus] = {}
    for name, both in by_bus(servos).items():
        nodes = [spec for spec in both if isinstance(spec, NodeSpec)]
        specs = [spec for spec in both if isinstance(spec, ServoSpec)]
        if nodes and specs:
            raise InvalidInput(f"bus {name}: {specs[0].model} and {nodes[0].model} cannot share a wire")
        if nodes:
            buses[name] = can_bus(name, nodes, scattered(len(nodes), line.seed, now), line, now=now)
            continue
        laid, start = laid_out(specs, line.seed)
        muscles = FirstOrderPhysics(np.array(start), now=now)
        buses[name] = virtual_bus(name, laid, muscles, line, baud=baud or FACTORY_BAUD, now=now)
    return buses


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


def virtual_bus(
    name: str,
    specs: Sequence[ServoSpec],
    muscles: ServoPhysics,
    line: BusTiming,
    *,
    baud: int,
    now: float,
    sensor: VirtualSensor | None = None,
) -> VirtualBus:
    """Build one bus; `sensor` is on it too. Raises InvalidInput for a model that cannot be
    simulated."""
    try:
        return VirtualBus(
            name,
            specs,
            muscles,
            baud=baud,
            wire_timing=line.wire_timing,
            now=now,
            adapter=line.adapter,
            seed=line.seed,
            sensor=sensor,
        )
    except (KeyError, ValueError) as error:
        raise InvalidInput(f"bus {name}: {error.args[0]}") from None


def can_bus(
    name: str,
    nodes: Sequence[NodeSpec],
    muscles: CanMotorPhysics,
    line: BusTiming,
    *,
    bitrate: int = BITRATE,
    now: float = 0.0,
) -> VirtualCanBus:
    """Build one CAN bus. Raises InvalidInput for a family or model that is not simulated."""
    try:
        return VirtualCanBus(
            name,
            nodes,
            muscles,
            bitrate=bitrate,
            wire_timing=line.wire_timing,
            now=now,
            adapter=CanAdapter(batch=USB if line.wire_timing else 0.0),
            seed=line.seed,
        )
    except (KeyError, ValueError) as error:
        raise InvalidInput(f"bus {name}: {error.args[0]}") from None


Spec = TypeVar("Spec")


def by_bus(servos: Sequence[tuple[str, Spec]]) -> Mapping[str, list[Spec]]:
    """Group the servos by bus, in the order given."""
    found: dict[str, list[Spec]] = {}
    for bus, spec in servos:
        found.setdefault(bus, []).append(spec)
    return found
