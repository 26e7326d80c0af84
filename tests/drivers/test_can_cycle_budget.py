"""Cost of a cycle on a CAN wire: the arithmetic of the facts, and a refusal that shows it."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.config.cycle_budget import budgets, require_rate
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError
from twind_drivers.can.can_cycle_budget import budget, frame_bits

MIXED = load_robot("h24-mixed")


@pytest.mark.parametrize(
    ("extended", "stuffed", "bits"), [(0, 0, 111), (0, 1, 135), (1, 0, 131), (1, 1, 160)]
)
def test_a_frame_of_eight_bytes_has_the_length_of_the_standard(
    extended: int, stuffed: int, bits: int
) -> None:
    assert frame_bits(8, extended=bool(extended), stuffed=bool(stuffed)) == bits


def test_a_frame_without_payload_has_at_most_eight_stuff_bits() -> None:
    assert (frame_bits(0, stuffed=False), frame_bits(0)) == (47, 55)


@pytest.mark.parametrize(("family", "bits"), [("damiao", 135), ("robstride", 160)])
def test_24_actuators_with_command_and_reply_take_what_was_computed(family: str, bits: int) -> None:
    """6.5 ms with ids of 11 bits, 7.7 with 29; and 2 ms a tick for upkeep."""
    found = budget({family: 24}, 1_000_000, 100.0)
    assert found.seconds == pytest.approx(48 * bits * 1e-6 + 0.002)
    assert found.frames == 48 + 2 * 6
    assert found.refusal(100.0) is None
    assert found.reachable_hz == pytest.approx(0.8 * 1e6 / (48 * bits), rel=1e-5)  # a fifth is for upkeep


def test_periodic_frames_take_their_share_at_any_rate() -> None:
    slow, fast = (budget({"odrive": 6}, 1_000_000, rate) for rate in (100.0, 400.0))
    assert slow.frames == pytest.approx(2 * 6 + 2 * 6 + 6 * 1.1)
    assert fast.frames == pytest.approx(2 * 6 + 2 * 1 + 6 * 1.1 / 4)
    assert slow.reachable_hz == fast.reachable_hz


@given(
    st.dictionaries(
        st.sampled_from(["damiao", "cubemars", "robstride", "odrive"]), st.integers(1, 20), min_size=1
    ),
    st.sampled_from([125_000, 500_000, 1_000_000]),
    st.floats(1.0, 1000.0),
)
def test_a_rate_is_refused_exactly_where_its_cycle_does_not_fit(
    counts: dict[str, int], bitrate: int, rate: float
) -> None:
    found = budget(counts, bitrate, rate)
    if abs(found.seconds * rate - 1.0) > 1e-4:
        assert (found.refusal(rate) is None) == (found.seconds * rate < 1.0)


def test_a_rate_out_of_reach_is_refused_with_the_arithmetic() -> None:
    found = budget({"damiao": 12}, 500_000, 200.0)
    text = found.refusal(200.0)
    assert text is not None
    assert "200 Hz leaves 5000 us a cycle, the bus needs 7480 us (up to 123 Hz)" in text
    assert "commands to 12 damiao and their replies: 24 frames of at most 135 bits = 6480 us" in text
    assert "upkeep: 1 registers, request and reply, at most 1000 us" in text
    assert "together 3740 bits at 500000 bit/s = 7480 us" in text
    assert found.refusal(123.0) is None


@pytest.mark.parametrize(
    ("counts", "bitrate", "rate"), [({}, 1, 1.0), ({"damiao": 1}, 0, 1.0), ({"damiao": 1}, 1, 0.0)]
)
def test_a_budget_of_nothing_is_refused(counts: dict[str, int], bitrate: int, rate: float) -> None:
    with pytest.raises(ValueError, match="needs actuators, a bitrate and a rate"):
        budget(counts, bitrate, rate)


def test_each_bus_of_a_mixed_robot_has_its_own_arithmetic() -> None:
    upper, left, right = require_rate(MIXED, 100.0)
    assert upper.lines[0].startswith("bus upper: 12 servos at 1000000 baud")
    for bus, name in ((left, "l_leg"), (right, "r_leg")):
        assert bus.bus.name == name
        assert bus.lines[0] == f"bus {name}: 6 CAN actuators at 1000000 bit/s, 100 Hz wanted"
        assert bus.lines[1] == "  24 frames, 3240 us, up to 494 Hz"


def test_a_can_bus_that_cannot_carry_the_rate_refuses_the_robot() -> None:
    slow = replace(
        MIXED, buses=tuple(replace(bus, baud=125_000) if bus.kind == "can" else bus for bus in MIXED.buses)
    )
    assert [each.bus.name for each in budgets(slow, 100.0) if each.refusal] == ["l_leg", "r_leg"]
    with pytest.raises(
        ConfigError, match="bus l_leg: 100 Hz leaves 10000 us a cycle, the bus needs 15120 us"
    ):
        require_rate(slow, 100.0)
