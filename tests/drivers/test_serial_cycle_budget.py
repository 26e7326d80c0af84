"""The cycle budget reproduces the wire arithmetic by hand, and a refusal shows it."""

from math import ceil

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.serial_cycle_budget import budget, upkeep

# (devices, fast, return delay us) -> bytes, cycles per second at each baud rate
BAUDS = (57_600, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
TABLE = {
    (20, True, 0): (436, (13, 229, 459, 688, 917, 1032)),
    (20, False, 0): (568, (10, 176, 352, 528, 704, 792)),
    (20, False, 500): (568, (9, 64, 78, 84, 88, 89)),
    (24, True, 0): (516, (11, 194, 388, 581, 775, 872)),
    (24, True, 50): (516, (11, 192, 380, 565, 746, 836)),
    (24, True, 500): (516, (11, 177, 325, 450, 559, 607)),
    (24, False, 0): (676, (9, 148, 296, 444, 592, 666)),
    (24, False, 50): (676, (8, 126, 218, 290, 346, 370)),
    (24, False, 500): (676, (8, 53, 65, 70, 73, 74)),
}


@pytest.mark.parametrize("shape", TABLE)
def test_bytes_and_rates_equal_the_table(shape: tuple[int, bool, int]) -> None:
    count, fast, delay = shape
    size, rates = TABLE[shape]
    for baud, rate in zip(BAUDS, rates, strict=True):
        found = budget(count, baud, fast=fast, return_delay_us=delay)
        assert found.bytes == size
        assert round(found.reachable_hz) == rate


@pytest.mark.parametrize("fast", [True, False])
@given(count=st.integers(1, 60))
@examples(20)
def test_bytes_equal_those_of_real_packets(fast: bool, count: int) -> None:
    ids = range(count)
    block = bytes(10)
    asked = (packet.fast_sync_read if fast else packet.sync_read)(ids, 126, 10)
    plain = b"".join(packet.status(id, 0, block) for id in ids)
    joint = b"".join(packet.fast_status([(0, id, block) for id in ids], count * 14 + 1))
    goals = packet.sync_write(116, {id: bytes(4) for id in ids})
    found = budget(count, 1_000_000, fast=fast, return_delay_us=0)
    assert found.bytes == len(goals) + len(asked) + len(joint if fast else plain)


def test_an_impossible_rate_is_refused_with_the_arithmetic() -> None:
    found = budget(24, 1_000_000, fast=False, return_delay_us=500)
    text = found.refusal(100.0)
    assert text is not None
    for part in ("10000 us", "18760 us", "53 Hz", "return delay: 24 x 500 us = 12000 us", "676 bytes"):
        assert part in text
    assert found.refusal(53.0) is None


@pytest.mark.parametrize(
    ("fast", "longest", "delays"),
    [(False, 20 + 6 * 46, 6), (True, 20 + 8 + 6 * 31, 1)],  # 6 x 35 bytes plain, 6 x 27 (health) fast
)
def test_the_longest_upkeep_and_the_adapter_are_in_the_sum(fast: bool, longest: int, delays: int) -> None:
    bare = budget(24, 1_000_000, fast=fast, return_delay_us=50)
    full = budget(24, 1_000_000, fast=fast, return_delay_us=50, upkeep_hz=100.0, usb_s=0.001)
    assert full.bytes - bare.bytes == longest
    assert full.seconds - bare.seconds == pytest.approx(longest * 1e-5 + delays * 50e-6 + 0.002)


@pytest.mark.parametrize("fast", [True, False])
@given(
    groups=st.lists(st.integers(1, 30), min_size=1, max_size=2),
    rate=st.integers(40, 1000),
    room=st.integers(0, 1200),
)
@examples(100)
def test_the_upkeep_plan_reaches_its_refresh_rates(
    fast: bool, groups: list[int], rate: int, room: int
) -> None:
    plan = upkeep(groups, rate, fast=fast, fits=lambda count, size: count * size <= room)

    def slices(size: int) -> int:
        return sum(ceil(count / size) for count in groups)

    turns = slices(plan.state) + (slices(plan.watch) if plan.watch else 0)
    assert turns <= max(plan.slots - 1, len(groups))
    assert rate / plan.slots >= 20.0
    assert slices(plan.health) <= max(4, len(groups))
    least = upkeep(groups, rate, fast=fast)
    assert plan == least or all(count * size <= room for count, size in plan.status_rows)


@pytest.mark.parametrize("fast", [True, False])
def test_a_bus_of_two_layouts_is_summed_with_its_bulk_read(fast: bool) -> None:
    spans = {id: (126 if id < 6 else 574, 10) for id in range(10)}
    asked = (packet.fast_bulk_read if fast else packet.bulk_read)(spans)
    one = budget(10, 10**6, fast=fast, return_delay_us=0, groups=(6, 4))
    two = len(asked)
    reply = 8 + 10 * 14 if fast else 10 * 21
    goals = sum(
        len(packet.sync_write(at, dict.fromkeys(range(n), bytes(4)))) for at, n in ((116, 6), (564, 4))
    )
    assert one.bytes == goals + two + reply


def test_no_devices_or_no_baud_rate_is_refused() -> None:
    for count, baud in ((0, 1_000_000), (1, 0)):
        with pytest.raises(ValueError, match="needs devices"):
            budget(count, baud, fast=True, return_delay_us=0)
