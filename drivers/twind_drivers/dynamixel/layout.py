"""Where the registers of one bus lie: the blocks that are read and written together. Pure.

All devices of a bus share one layout (the X and MX-2.0 tables do, and so does the P series among itself).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from twind_drivers.dynamixel.tables import Field, Table


@dataclass(frozen=True, slots=True)
class Block:
    """A span of addresses."""

    address: int
    size: int  # bytes

    def offset(self, field: Field) -> int | None:
        """Where `field` begins in this block; None if it is not wholly inside."""
        inside = self.address <= field.address and field.end <= self.address + self.size
        return field.address - self.address if inside else None


@dataclass(frozen=True, slots=True)
class Layout:
    """The blocks of one bus."""

    cyclic: Block  # effort (current or load) 2, velocity 4, position 4
    goal: Block
    torque: Block
    watchdog: Block
    status: Block  # torque enable .. bus watchdog
    health: Block  # voltage 2, temperature 1
    gains: Block  # position D, I, P: 2 each
    profile: Block  # profile acceleration 4, profile velocity 4
    motion: Block  # profile and goal position


def layout_of(tables: Sequence[Table]) -> Layout:
    """The layout that all `tables` share. Raises ValueError that names the models which do not."""
    if not tables:
        raise ValueError("a bus needs at least one device")
    layouts = {table.model: _layout(table) for table in tables}
    first = layouts[tables[0].model]
    others = sorted(model for model, layout in layouts.items() if layout != first)
    if others:
        raise ValueError(
            f"one bus needs one register layout: {', '.join(others)} differ from {tables[0].model}; "
            "put them on another bus"
        )
    return first


def _layout(table: Table) -> Layout:
    effort = "present_current" if "present_current" in table else "present_load"
    try:
        layout = Layout(
            cyclic=_span(table, effort, "present_velocity", "present_position"),
            goal=_span(table, "goal_position"),
            torque=_span(table, "torque_enable"),
            watchdog=_span(table, "bus_watchdog"),
            status=_span(table, "torque_enable", "hardware_error_status", "bus_watchdog"),
            health=_span(table, "present_input_voltage", "present_temperature"),
            gains=_span(table, "position_d_gain", "position_i_gain", "position_p_gain"),
            profile=_span(table, "profile_acceleration", "profile_velocity"),
            motion=_span(table, "profile_acceleration", "profile_velocity", "goal_position"),
        )
    except KeyError as error:
        raise ValueError(f"{table.model} cannot be driven: {error.args[0]}") from error
    sizes = tuple(
        getattr(layout, name).size for name in ("cyclic", "goal", "status", "health", "gains", "motion")
    )
    if sizes != (10, 4, 35, 3, 6, 12):
        raise ValueError(
            f"{table.model} cannot be driven: its registers do not lie in the X or P series' order"
        )
    return layout


def _span(table: Table, *names: str) -> Block:
    """From the first of `names` to the end of the last."""
    first, last = table[names[0]], table[names[-1]]
    return Block(first.address, max(0, last.end - first.address))
