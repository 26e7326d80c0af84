"""Keys of types and slots that families of serial servos read alike. All raise ConfigError at the line."""

from collections.abc import Collection
from typing import Annotated

from msgspec import Meta

from twind.config.actuator_types import TypeSpec
from twind.config.config_reader import ConfigReader
from twind.config.driver_family import SlotEntry
from twind.config.family_keys import SlotKeys
from twind.config.robot_spec import ActuatorSlot


def read_required(
    section: ConfigReader, title: str, known: Collection[str], least: int, most: int
) -> dict[str, int]:
    """Return the required register values by name. `known`: the registers of the model, which is `title`."""
    for key in section:
        if key not in known:
            raise section.refuse(key, f"{title} has no {key}: {', '.join(known)}")
    return {key: section.value(key, Annotated[int, Meta(ge=least, le=most)]) for key in section}


def require_even_delay(section: ConfigReader, delay_us: int) -> None:
    """Refuse a return delay that no register holds: it counts in steps of 2 µs."""
    if delay_us % 2:
        raise section.refuse("return_delay_us", f"{delay_us} is odd: the register counts in steps of 2 µs")


def read_choice(section: ConfigReader, choices: Collection[str], usual: str) -> str:
    """Return the operating mode, one of `choices`; `usual` where the section has none."""
    return section.choice("mode", choices) if section.has("mode") else usual


def make_slot(
    entry: SlotEntry, given: SlotKeys, id: int, kind: TypeSpec, mode: str, registers: dict[str, int]
) -> ActuatorSlot:
    """Return the servo of a joint, or of an actuator beside the joints."""
    own = {**kind.registers, **registers}
    return ActuatorSlot(entry.name, entry.bus, id, kind, given.sign, given.ratio, own, mode, feedback_id=None)
