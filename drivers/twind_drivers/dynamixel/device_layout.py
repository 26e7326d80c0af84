"""Layout of a device's registers: the blocks that are read and written together. Pure.

The X and MX-2.0 tables share one layout, the P series another, the Y series a third. One bus may have
devices of several.
"""

from dataclasses import dataclass
from itertools import product

from twind.exceptions import InvalidInput
from twind_drivers.dynamixel.control_tables import ControlTable, TableRegister


@dataclass(frozen=True, slots=True)
class RegisterBlock:
    """Span of register addresses."""

    address: int
    size: int  # bytes

    def offset(self, field: TableRegister) -> int | None:
        """Return the offset (bytes) of `field` in this block; None if it is not wholly inside."""
        inside = self.address <= field.address and field.end <= self.address + self.size
        return field.address - self.address if inside else None


@dataclass(frozen=True, slots=True)
class DeviceLayout:
    """Register blocks of one kind of device."""

    cyclic: RegisterBlock  # effort (current or load) 2, velocity 4, position 4
    goal: RegisterBlock
    torque: RegisterBlock
    watchdog: RegisterBlock
    # torque enable, hardware error and bus watchdog, in the blocks that they lie in: one, or three of a Y
    status: tuple[RegisterBlock, ...]
    state: tuple[RegisterBlock, ...]  # the same without the watchdog
    health: RegisterBlock  # realtime tick 2 .. voltage 2, temperature 1
    gains: RegisterBlock  # position D, I, P: 2 each, 4 of a Y
    profile: RegisterBlock  # profile acceleration 4, profile velocity 4
    motion: RegisterBlock | None  # profile and goal position; None: they lie apart
    # Longer blocks around the cyclic one: (bytes before it, bytes of the whole). Sizes differ from each
    # other, so that a late reply is recognised by its length.
    wider: tuple[tuple[int, int], ...]


SIZES = {"cyclic": 10, "goal": 4, "health": 27, "gains": 6, "profile": 8, "motion": 12}
Y_SIZES = SIZES | {"health": 30, "gains": 12}
STATUS = 35  # bytes
STATE = 7
MOTION = 12


def layout_of(table: ControlTable) -> DeviceLayout:
    """Return the layout of a model. Raises ValueError with the reason if it cannot be driven."""
    effort = "present_current" if "present_current" in table else "present_load"
    parts = ("torque_enable", "hardware_error_status", "bus_watchdog")
    goal = ("profile_acceleration", "profile_velocity", "goal_position")
    try:
        apart = table["bus_watchdog"].address < table["torque_enable"].address  # a Y
        status = tuple(_span(table, part) for part in parts) if apart else (_span(table, *parts),)
        layout = DeviceLayout(
            cyclic=_span(table, effort, "present_velocity", "present_position"),
            goal=_span(table, "goal_position"),
            torque=_span(table, "torque_enable"),
            watchdog=_span(table, "bus_watchdog"),
            status=status,
            state=status[:2] if apart else (_span(table, *parts[:2]),),
            health=_span(table, "realtime_tick", "present_input_voltage", "present_temperature"),
            gains=_span(table, "position_d_gain", "position_i_gain", "position_p_gain"),
            profile=_span(table, "profile_acceleration", "profile_velocity"),
            motion=None if apart else _span(table, *goal),
            wider=_wider(table, effort),
        )
    except InvalidInput as error:
        raise ValueError(f"{table.model} cannot be driven: {error}") from error
    sizes = Y_SIZES if apart else SIZES
    blocks = [(getattr(layout, name), size) for name, size in sizes.items()]
    if not apart:
        blocks += [(layout.status[0], STATUS), (layout.state[0], STATE)]
    if any(block is not None and block.size != size for block, size in blocks):
        raise ValueError(
            f"{table.model} cannot be driven: its registers do not lie in the order of the X, P or Y series"
        )
    return layout


def _wider(table: ControlTable, effort: str) -> tuple[tuple[int, int], ...]:
    """Return the longer blocks around the cyclic one that begin and end at register borders.

    Size 12 is left out: a late reply of it would pass for the read-back of `motion`.
    """
    first = table[effort].address
    last = table["present_position"].end
    before = ("realtime_tick", "moving", "moving_status", "present_pwm", effort)
    starts = [table[name].address for name in before if name in table]
    ends = [table[name].end for name in ("velocity_trajectory", "position_trajectory") if name in table]
    found = {
        end - start: (first - start, end - start)
        for start, end in product(starts, (last, *ends))
        if first - 6 <= start and end <= last + 8
    }
    return tuple(found[size] for size in sorted(found) if size not in (last - first, MOTION))


def _span(table: ControlTable, *names: str) -> RegisterBlock:
    """Return the block from the first of `names` to the end of the last."""
    first = table[names[0]]
    last = table[names[-1]]
    return RegisterBlock(first.address, max(0, last.end - first.address))
