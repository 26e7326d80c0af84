"""Section `buses` of a robot file: serial buses of servos, and CAN buses. Read once, checked."""

import re
from typing import Annotated, Literal

from msgspec import Meta

from twind.config.actuator_types import CAN
from twind.config.config_reader import ConfigReader, ConfigStruct, Text
from twind.config.port_names import wrong_port
from twind.config.robot_spec import BusSpec

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


class BusKeys(ConfigStruct):
    """Entry of `buses`, of either kind."""

    kind: Literal["dynamixel2", "can"]
    """servos or CAN actuators"""
    port: Text | None = None
    """port | | as `ports` of the settings, which override it"""


class SerialBusKeys(BusKeys):
    """Entry of a serial bus."""

    baud: Literal[9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000] = 1_000_000
    """9600–4500000, a servo rate | | baud rate of the servos"""
    latency_timer_ms: Annotated[int, Meta(ge=0, le=255)] = 1
    """of the USB adapter, for the bus budget only; 0: no USB adapter"""
    one_write: bool = True
    """`false` for adapters or servos that lose back-to-back packets"""


class CanBusKeys(BusKeys):
    """Entry of a CAN bus. The bit rates are those that slcan has a command for (S4 to S8)."""

    bitrate: Literal[125_000, 250_000, 500_000, 800_000, 1_000_000] = 1_000_000
    """CAN: bit/s"""


def buses(section: ConfigReader) -> tuple[BusSpec, ...]:
    """All buses of a robot. Raises ConfigError."""
    found = tuple(_bus(name, each) for name, each in section.sections(NAME).items())
    if not found:
        raise section.refuse("", "a robot needs at least one bus")
    return found


def _bus(name: str, section: ConfigReader) -> BusSpec:
    kind = section.read(BusKeys, SerialBusKeys, CanBusKeys).kind
    if kind == CAN:
        can = section.read(CanBusKeys)
        bus = BusSpec(name, kind, can.port, can.bitrate, latency_timer_ms=0)
    else:
        serial = section.read(SerialBusKeys)
        bus = BusSpec(name, kind, serial.port, serial.baud, serial.latency_timer_ms, serial.one_write)
    if bus.port is not None and (wrong := wrong_port(kind, bus.port)) is not None:
        raise section.refuse("port", wrong)
    return bus
