"""Layouts: the blocks of each series, and which models cannot be driven."""

import pytest

from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.device_layout import RegisterBlock, layout_of


@pytest.mark.parametrize("number", [1020, 1060, 1200, 30, 1110])
def test_the_x_and_mx_series_blocks_are_at_the_documented_addresses(number: int) -> None:
    x = layout_of(table(number))
    assert (x.cyclic, x.goal, x.status) == (
        RegisterBlock(126, 10),
        RegisterBlock(116, 4),
        RegisterBlock(64, 35),
    )
    assert (x.state, x.health, x.gains, x.motion) == (
        RegisterBlock(64, 7),
        RegisterBlock(120, 27),
        RegisterBlock(80, 6),
        RegisterBlock(108, 12),
    )
    assert (x.torque, x.watchdog, x.profile) == (
        RegisterBlock(64, 1),
        RegisterBlock(98, 1),
        RegisterBlock(108, 8),
    )


@pytest.mark.parametrize("number", [2000, 2120])
def test_the_p_series_has_the_same_blocks_from_512_on(number: int) -> None:
    p = layout_of(table(number))
    assert (p.cyclic, p.goal, p.status) == (
        RegisterBlock(574, 10),
        RegisterBlock(564, 4),
        RegisterBlock(512, 35),
    )
    assert (p.state, p.health) == (RegisterBlock(512, 7), RegisterBlock(568, 27))


@pytest.mark.parametrize("number", [1020, 1060, 2000])
def test_longer_cyclic_blocks_hold_whole_readable_registers_and_have_sizes_of_their_own(number: int) -> None:
    each = table(number)
    layout = layout_of(each)
    borders = {field.address for field in each.fields.values()} | {
        field.end for field in each.fields.values()
    }
    sizes = [size for _, size in layout.wider]
    assert len(set(sizes)) == len(sizes) >= 8
    others = {getattr(layout, name).size for name in ("cyclic", "state", "status", "health", "motion")}
    assert others.isdisjoint(sizes)
    for before, size in layout.wider:
        start = layout.cyclic.address - before
        assert {start, start + size} <= borders
        assert start + size >= layout.cyclic.address + 10
        named = [field for field in each.fields.values() if start <= field.address < start + size]
        assert sum(field.size for field in named) == size  # without a gap: reading that is error 7


@pytest.mark.parametrize(("name", "lacks"), [("XL320", "bus_watchdog"), ("YM070-210-A099", "hardware_error")])
def test_a_model_that_cannot_be_driven_is_refused_with_the_reason(name: str, lacks: str) -> None:
    with pytest.raises(ValueError, match=f"{name} cannot be driven: .*{lacks}"):
        layout_of(table(number_of(name)))


def test_a_field_is_found_in_a_block_only_if_it_is_whole() -> None:
    goal = table(1020)["goal_position"]
    assert RegisterBlock(108, 12).offset(goal) == 8
    assert RegisterBlock(108, 11).offset(goal) is None
    assert RegisterBlock(117, 12).offset(goal) is None
