"""Rules of the operating modes: what a model can, which bounds and caps a mode takes, which words it gets."""

import pytest

from twind.exceptions import InvalidInput
from twind_drivers.dynamixel.control_tables import ControlTable, number_of, table
from twind_drivers.dynamixel.operating_modes import MODES, block, check_bounds, check_cap, fences, mode_of

WIDE = 1_048_575
NONE = (0, -1)  # an empty range


def of(model: str) -> ControlTable:
    return table(number_of(model))


# e-manual, "Operating Mode (11)"
@pytest.mark.parametrize(
    ("mode", "name", "goal", "limit", "rests_at_zero"),
    [
        (0, "current", "goal_current", "current_limit", True),
        (1, "velocity", "goal_velocity", "velocity_limit", True),
        (3, "position", "goal_position", None, False),
        (4, "extended position", "goal_position", None, False),
        (5, "current-based position", "goal_position", None, False),
    ],
)
def test_each_mode_has_its_goal_and_its_limit(
    mode: int, name: str, goal: str, limit: str | None, rests_at_zero: bool
) -> None:
    found = mode_of("here", of("XM430-W350"), mode)
    assert (found.number, found.name, found.goal, found.limit) == (mode, name, goal, limit)
    assert found.rests_at_zero is rests_at_zero


def test_a_mode_that_is_not_driven_is_refused_with_all_that_are() -> None:
    with pytest.raises(ValueError) as refused:
        mode_of("arm: id 1", of("XM430-W350"), 16)
    assert str(refused.value) == (
        "arm: id 1: operating mode 16 is not driven here; known are 0 current, 1 velocity, 3 position, "
        "4 extended position, 5 current-based position"
    )


@pytest.mark.parametrize(
    ("model", "mode", "words"),
    [
        ("XL320", 3, "here: XL320 is not driven here: it has no bus watchdog"),
        ("XL430-W250", 0, "here: XL430-W250 has no goal_current: mode 0 is not possible"),
        ("XL430-W250", 5, "here: XL430-W250 has no goal_current: mode 5 is not possible"),
        ("PH54-200-S500", 5, r"here: PH54-200-S500 has no mode 5; it has \[0, 1, 3, 4, 16\]"),
        ("YM070-210-R099", 4, r"here: YM070-210-R099 has no mode 4; it has \[0, 1, 3\]"),
        ("RH-P12-RN", 3, r"here: RH-P12-RN has no mode 3; it has \[0, 5\]"),
    ],
)
def test_a_model_without_a_mode_is_refused_with_the_reason(model: str, mode: int, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        mode_of("here", of(model), mode)


# Modes whose goals rest at 0: the ends are inclusive, and a device must be able to rest.
@pytest.mark.parametrize("bounds", [(0, 0), (-1023, 1023), (0, 1023), (-1023, 0)])
def test_bounds_of_speeds_may_end_at_zero_and_at_the_range_of_the_register(bounds: tuple[int, int]) -> None:
    check_bounds("here", of("XM430-W350"), MODES[1], *bounds)


@pytest.mark.parametrize(
    ("mode", "bounds", "words"),
    [
        (1, (1, 5), r"here: bounds 1\.\.5 of mode 1 must hold 0, to rest"),
        (0, (-5, -1), r"here: bounds -5\.\.-1 of mode 0 must hold 0, to rest"),
        (
            1,
            (-1024, 0),
            r"-1024\.\.0 of mode 1 leave -1023\.\.1023, the range of goal_velocity of XM430-W350",
        ),
        (1, (0, 1024), r"0\.\.1024 of mode 1 leave -1023\.\.1023"),
        (0, (-1194, 0), r"leave -1193\.\.1193, the range of goal_current"),
        (4, (-WIDE - 1, 0), r"leave -1048575\.\.1048575, the range of goal_position"),
        (5, (0, WIDE + 1), r"of mode 5 leave -1048575\.\.1048575"),
    ],
)
def test_bounds_that_a_mode_cannot_have_are_refused(mode: int, bounds: tuple[int, int], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        check_bounds("here", of("XM430-W350"), MODES[mode], *bounds)


@pytest.mark.parametrize(
    ("mode", "bounds"), [(3, (-WIDE - 1, 5)), (3, (5, 6)), (4, (5, 6)), (5, (-WIDE, WIDE))]
)
def test_bounds_of_positions_need_no_zero_and_in_mode_3_no_range(mode: int, bounds: tuple[int, int]) -> None:
    check_bounds("here", of("XM430-W350"), MODES[mode], *bounds)


@pytest.mark.parametrize("cap", [1, 1193])
def test_a_cap_may_be_as_small_as_one_and_as_large_as_the_register(cap: int) -> None:
    check_cap("here", of("XM430-W350"), MODES[5], cap)


@pytest.mark.parametrize("cap", [None, 0, -1, 1194])
def test_mode_5_needs_a_cap_in_range(cap: int | None) -> None:
    with pytest.raises(
        ValueError, match=rf"here: mode 5 needs a current cap of 1\.\.1193 counts, got {cap}$"
    ):
        check_cap("here", of("XM430-W350"), MODES[5], cap)


@pytest.mark.parametrize("mode", [0, 1, 3, 4])
def test_another_mode_takes_no_cap(mode: int) -> None:
    check_cap("here", of("XM430-W350"), MODES[mode], None)
    with pytest.raises(ValueError, match=f"here: a current cap belongs to mode 5, not to mode {mode}"):
        check_cap("here", of("XM430-W350"), MODES[mode], 5)


@pytest.mark.parametrize(
    ("mode", "cap", "current", "velocity", "position"),
    [
        (0, None, (-5, 7), NONE, NONE),
        (1, None, (0, 1193), (-5, 7), NONE),
        (3, None, (0, 1193), NONE, (-5, 7)),
        (4, None, (0, 1193), NONE, (-5, 7)),
        (5, 500, (0, 500), NONE, (-5, 7)),
    ],
)
def test_only_the_goal_of_the_mode_is_written_and_a_current_up_to_its_cap(
    mode: int, cap: int | None, current: tuple[int, int], velocity: tuple[int, int], position: tuple[int, int]
) -> None:
    registers = of("XM430-W350")
    found = fences(registers, MODES[mode], -5, 7, cap)
    names = ("goal_current", "goal_velocity", "goal_position")
    assert [found[block(registers, name)] for name in names] == [current, velocity, position]
    assert len(found) == 3


def test_a_model_without_goal_current_has_fences_for_its_other_goals() -> None:
    registers = of("XL430-W250")
    found = fences(registers, MODES[1], -5, 7, None)
    assert found == {block(registers, "goal_velocity"): (-5, 7), block(registers, "goal_position"): NONE}


def test_a_block_spans_from_the_first_register_to_the_end_of_the_last() -> None:
    found = block(of("XM430-W350"), "profile_acceleration", "goal_position")
    assert (found.address, found.size) == (108, 12)
    with pytest.raises(InvalidInput, match="goal_curent"):
        block(of("XM430-W350"), "goal_curent")
