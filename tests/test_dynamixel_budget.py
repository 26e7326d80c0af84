"""The cycle budget reproduces the wire arithmetic by hand, and a refusal shows it."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.budget import budget, upkeep

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
@settings(max_examples=20, deadline=None)
def test_bytes_equal_those_of_real_packets(fast: bool, count: int) -> None:
    ids, block = range(count), bytes(10)
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


def test_upkeep_and_adapter_are_in_the_sum() -> None:
    bare = budget(24, 1_000_000, fast=True, return_delay_us=0)
    full = budget(24, 1_000_000, fast=True, return_delay_us=0, upkeep_hz=100.0, usb_s=0.001)
    assert full.bytes - bare.bytes == 14 + 6 + 6 * 46
    assert full.seconds - bare.seconds == pytest.approx(296e-5 + 0.002)


@given(st.integers(1, 60), st.integers(40, 1000))
@settings(max_examples=100, deadline=None)
def test_the_upkeep_plan_reaches_its_refresh_rates(count: int, rate: int) -> None:
    plan = upkeep(count, rate)
    assert plan.status * (plan.slots - 1) >= count
    assert rate / plan.slots >= 20.0
    assert plan.health * 4 >= count


def test_no_devices_or_no_baud_rate_is_refused() -> None:
    for count, baud in ((0, 1_000_000), (1, 0)):
        with pytest.raises(ValueError, match="needs devices"):
            budget(count, baud, fast=True, return_delay_us=0)
