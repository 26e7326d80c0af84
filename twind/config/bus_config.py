"""Section `buses` of a robot file: each bus by the driver family of its kind. Read once, checked."""

import re

from twind.config.config_reader import ConfigReader
from twind.config.driver_family import families, family, kinds
from twind.config.port_names import wrong_port
from twind.config.robot_spec import BusSpec

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def buses(section: ConfigReader) -> tuple[BusSpec, ...]:
    """All buses of a robot. Raises ConfigError."""
    found = tuple(_bus(name, each) for name, each in section.sections(NAME).items())
    if not found:
        raise section.refuse("", "a robot needs at least one bus")
    return found


def _bus(name: str, section: ConfigReader) -> BusSpec:
    if not section.has("kind"):  # a misspelt key before a missing one
        section.read(*(each.bus_keys for each in families()))
    driver = family(section.choice("kind", kinds()))
    bus = driver.read_bus(name, section)
    if bus.port is not None and (wrong := wrong_port(driver.medium, bus.port, bus.kind)) is not None:
        raise section.refuse("port", wrong)
    return bus
