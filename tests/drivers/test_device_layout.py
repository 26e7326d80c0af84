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
        (RegisterBlock(64, 35),),
    )
    assert (x.state, x.health, x.gains, x.motion) == (
        (RegisterBlock(64, 7),),
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
        (RegisterBlock(512, 35),),
    )
    assert (p.state, p.health) == ((RegisterBlock(512, 7),), RegisterBlock(568, 27))


def test_the_status_of_a_y_lies_in_three_blocks() -> None:
    y = layout_of(table(number_of("YM070-210-A099")))
    assert y.status == (RegisterBlock(512, 1), RegisterBlock(153, 1), RegisterBlock(8, 2))
    assert (y.cyclic, y.goal, y.gains) == (
        RegisterBlock(546, 10),
        RegisterBlock(532, 4),
        RegisterBlock(224, 12),
    )
    assert (y.health, y.profile, y.motion) == (RegisterBlock(542, 30), RegisterBlock(240, 8), None)


@pytest.mark.parametrize("number", [1020, 1060, 2000])
def test_longer_cyclic_blocks_hold_whole_readable_registers_and_have_sizes_of_their_own(number: int) -> None:
    each = table(number)
    layout = layout_of(each)
    borders = {field.address for field in each.fields.values()} | {
        field.end for field in each.fields.values()
    }
    sizes = [size for _, size in layout.wider]
    assert len(set(sizes)) == len(sizes) >= 8
    assert layout.motion is not None
    blocks = (layout.cyclic, *layout.state, *layout.status, layout.health, layout.motion)
    others = {block.size for block in blocks}
    assert others.isdisjoint(sizes)
    for before, size in layout.wider:
        start = layout.cyclic.address - before
        assert {start, start + size} <= borders
        assert start + size >= layout.cyclic.address + 10
        named = [field for field in each.fields.values() if start <= field.address < start + size]
        assert sum(field.size for field in named) == size  # without a gap: reading that is error 7


def test_a_model_that_cannot_be_driven_is_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match=r"XL320 cannot be driven: .*bus_watchdog"):
        layout_of(table(number_of("XL320")))


def test_a_field_is_found_in_a_block_only_if_it_is_whole() -> None:
    goal = table(1020)["goal_position"]
    assert RegisterBlock(108, 12).offset(goal) == 8
    assert RegisterBlock(108, 11).offset(goal) is None
    assert RegisterBlock(117, 12).offset(goal) is None
