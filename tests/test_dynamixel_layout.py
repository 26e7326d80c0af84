"""Layouts: the blocks of each series, and which models cannot be driven together or at all."""

import pytest

from twind_drivers.dynamixel.layout import Block, layout_of
from twind_drivers.dynamixel.tables import number_of, table


def test_the_x_and_p_series_blocks_are_where_the_manual_says() -> None:
    x = layout_of([table(1020), table(1060), table(1200)])
    assert (x.cyclic, x.goal, x.status) == (Block(126, 10), Block(116, 4), Block(64, 35))
    assert (x.health, x.gains, x.motion) == (Block(144, 3), Block(80, 6), Block(108, 12))
    assert (x.torque, x.watchdog, x.profile) == (Block(64, 1), Block(98, 1), Block(108, 8))
    p = layout_of([table(2000), table(2120)])
    assert (p.cyclic, p.goal, p.status) == (Block(574, 10), Block(564, 4), Block(512, 35))


@pytest.mark.parametrize("name", ["XL320", "YM070-210-A099"])
def test_a_model_with_another_order_of_registers_is_refused_by_name(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} cannot be driven"):
        layout_of([table(number_of(name))])


def test_an_empty_bus_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        layout_of([])


def test_a_field_is_found_in_a_block_only_if_it_is_whole() -> None:
    goal = table(1020)["goal_position"]
    assert Block(108, 12).offset(goal) == 8
    assert Block(108, 11).offset(goal) is None
    assert Block(117, 12).offset(goal) is None
