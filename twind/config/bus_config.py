"""Section `buses` of a robot file: serial buses of servos, and CAN buses. Read once, checked."""

import re

from twind.config.actuator_types import CAN, SERIAL
from twind.config.config_section import ConfigSection
from twind.config.port_names import wrong_port
from twind.config.robot_spec import BusSpec

KINDS = (SERIAL, CAN)
BAUDS = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
BITRATES = (125_000, 250_000, 500_000, 800_000, 1_000_000)  # bit/s; what slcan has a command for (S4 to S8)
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def buses(section: ConfigSection) -> tuple[BusSpec, ...]:
    """All buses of a robot. Raises ConfigError."""
    found = tuple(_bus(name, section) for name in section)
    if not found:
        raise section.refuse("", "a robot needs at least one bus")
    section.close()
    return found


def _bus(name: str, parent: ConfigSection) -> BusSpec:
    if not NAME.fullmatch(name):
        raise parent.refuse(name, "a bus is named by letters, digits, _ . and -")
    section = parent.section(name)
    kind = section.text("kind", None, KINDS)
    port = section.text("port") if section.has("port") else None
    if port is not None and (wrong := wrong_port(kind, port)) is not None:
        raise section.refuse("port", wrong)
    bus = (_can if kind == CAN else _serial)(name, section, port)
    section.close()
    return bus


def _serial(name: str, section: ConfigSection, port: str | None) -> BusSpec:
    baud = section.integer("baud", 1_000_000)
    if baud not in BAUDS:
        raise section.refuse("baud", f"{baud} is not a rate of these servos: {', '.join(map(str, BAUDS))}")
    return BusSpec(
        name=name,
        kind=SERIAL,
        port=port,
        baud=baud,
        latency_timer_ms=section.integer("latency_timer_ms", 1, least=0, most=255),
        one_write=section.flag("one_write", True),
    )


def _can(name: str, section: ConfigSection, port: str | None) -> BusSpec:
    bitrate = section.integer("bitrate", 1_000_000)
    if bitrate not in BITRATES:
        raise section.refuse("bitrate", f"{bitrate} is none of {', '.join(map(str, BITRATES))} bit/s")
    return BusSpec(name=name, kind=CAN, port=port, baud=bitrate, latency_timer_ms=0)
