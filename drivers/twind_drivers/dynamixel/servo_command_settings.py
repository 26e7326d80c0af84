"""Command state of one servo: its mode, its register blocks, its gains and caps. Pure."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from twind_drivers.bus import WriteRequest
from twind_drivers.dynamixel.control_tables import ControlTable
from twind_drivers.dynamixel.device_layout import DeviceLayout, RegisterBlock, layout_of
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.operating_modes import (
    POSITION,
    VELOCITY,
    OperatingMode,
    block,
    check_cap,
    mode_of,
)

MAX_ACCELERATION = 32767  # counts of register 108 (e-manual)

Rows = list[tuple[int, RegisterBlock, bytes]]  # id, registers, data


class RawGains(NamedTuple):
    """Position loop gains, raw; None: the model's default."""

    p: int | None = None
    i: int | None = None
    d: int | None = None


@dataclass(frozen=True, slots=True)
class ServoCommandSettings:
    """Command state of one servo."""

    id: int
    table: ControlTable
    layout: DeviceLayout
    mode: OperatingMode
    gains: bytes  # D, I, P as they lie in the registers
    cap: int | None  # goal current in mode 5, counts
    acceleration: int | None  # profile acceleration in mode 1, counts; None: unchanged

    def register_span(self, *names: str) -> RegisterBlock:
        """Return the block from the first of these registers to the end of the last."""
        return block(self.table, *names)

    @property
    def goal(self) -> RegisterBlock:
        """Goal register of its mode."""
        return self.register_span(self.mode.goal)

    @property
    def most_pwm(self) -> int:
        """Largest PWM limit of this model, counts; 0 without such a register."""
        return self.table["goal_pwm"].bounds[1] if "goal_pwm" in self.table else 0

    @property
    def capped_by(self) -> str:
        """Register that caps the output: goal current in mode 5, else goal PWM."""
        return "goal_pwm" if self.cap is None else "goal_current"

    def watchdog_row(self, units: int) -> tuple[RegisterBlock, bytes]:
        """Return the row that sets the bus watchdog, x 20 ms; 0: off."""
        return self.layout.watchdog, units.to_bytes(self.layout.watchdog.size, "little")

    def motion_rows(self, goal: bytes) -> list[tuple[int, RegisterBlock, bytes]]:
        """Return the rows of profile 0 and goal, as they are read back."""
        if self.layout.motion is None:
            profile = self.layout.profile
            return [(self.id, profile, bytes(profile.size)), (self.id, self.goal, goal)]
        return [(self.id, self.layout.motion, bytes(8) + goal)]

    def word(self, goal: int) -> bytes:
        """Encode a goal for that register, little-endian."""
        return goal.to_bytes(self.goal.size, "little", signed=True)


def servos_of(
    reader: DynamixelReader,
    *,
    modes: Sequence[int] | None,
    caps: Sequence[int | None] | None,
    gains: Sequence[tuple[int | None, int | None, int | None]] | None,
    accelerations: Sequence[int | None] | None,
) -> tuple[ServoCommandSettings, ...]:
    """Make the command states (m) of a bus, in the order of its ids; None: the default for all.

    Raises ValueError naming the device for an impossible mode, a missing cap, a gain out of range.
    """
    count = len(reader.ids)
    given: tuple[Sequence[Any], ...] = (
        [POSITION] * count if modes is None else modes,
        [None] * count if caps is None else caps,
        [RawGains()] * count if gains is None else [RawGains(*one) for one in gains],
        [None] * count if accelerations is None else accelerations,
    )
    for each in given:
        if len(each) != count:
            raise ValueError(f"{reader.name}: one value for each of {count} devices needed, got {each}")
    return tuple(_servo(reader, *one) for one in zip(reader.ids, *given, strict=True))


def _servo(
    reader: DynamixelReader, id: int, mode: int, cap: int | None, gains: RawGains, acceleration: int | None
) -> ServoCommandSettings:
    where = f"{reader.name}: id {id}"
    table = reader.table(id)
    found = mode_of(where, table, mode)
    check_cap(where, table, found, cap)
    if acceleration is not None and (found.number != VELOCITY or not 0 <= acceleration <= MAX_ACCELERATION):
        raise ValueError(
            f"{where}: profile acceleration {acceleration} belongs to mode 1 and 0..{MAX_ACCELERATION}"
        )
    raw = b"" if found.rests_at_zero else _gain_bytes(where, table, gains)
    return ServoCommandSettings(id, table, layout_of(table), found, raw, cap, acceleration)


def _gain_bytes(where: str, table: ControlTable, gains: RawGains) -> bytes:
    """Encode the gains D, I, P in register order."""
    parts = []
    for key, wanted in (("d", gains.d), ("i", gains.i), ("p", gains.p)):
        field = table[f"position_{key}_gain"]
        value = field.rule.default if wanted is None else wanted
        if value is None:
            raise ValueError(f"{where}: no default of {field.name} known for {table.model}: set it")
        field.check(value)
        parts.append(field.encode(value))
    return b"".join(parts)


def rows(
    servos: Iterable[ServoCommandSettings],
    what: Callable[[ServoCommandSettings], tuple[RegisterBlock, bytes]],
) -> Rows:
    """Return one row of `what` per servo."""
    return [(servo.id, *what(servo)) for servo in servos]


def groups(wanted: Rows) -> dict[RegisterBlock, Mapping[int, bytes]]:
    """Group rows by register block: one group packet, or one read, for each."""
    found: dict[RegisterBlock, dict[int, bytes]] = {}
    for id, where, data in wanted:
        found.setdefault(where, {})[id] = data
    return dict(found)


def writes(wanted: Rows) -> tuple[WriteRequest, ...]:
    """Return one group write for each register block."""
    return tuple(WriteRequest(data, where.address) for where, data in groups(wanted).items())
