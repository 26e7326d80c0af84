"""The MIT frame: golden bytes, truncation, ends of every field, and what is refused."""

from fractions import Fraction
from math import floor, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.can_codec_frames import column, frame, ranges
from tests.support.examples import examples
from twind_drivers.bus import Floats, WireRangeError
from twind_drivers.can.can_models import MODELS
from twind_drivers.can.mit_frame import (
    BITS,
    KD,
    KP,
    NAMES,
    WIDE,
    FieldScale,
    commands,
    is_special_frame,
    unpack,
)
from twind_drivers.ports.frame import Octets

TOLD = (16, 12, 12)
# Ranges 12.5, 30, 10: position, velocity, kp, kd, torque -> bytes, worked out from the layout in the manual.
GOLDEN = {
    "nothing": ((0.0, 0.0, 0.0, 0.0, 0.0), "7F FF 7F F0 00 00 07 FF"),
    "a place": ((1.0, 0.0, 50.0, 1.0, 0.0), "8A 3C 7F F1 99 33 37 FF"),
    "everything": ((-pi, 5.0, 100.0, 2.5, -3.5), "5F D4 95 43 33 7F F5 32"),
}


def scale(position: float = 12.5, velocity: float = 30.0, torque: float = 10.0) -> FieldScale:
    return FieldScale("can0", [7], ranges(1, position, velocity, torque), BITS, TOLD)


def encoded(values: tuple[float, ...], by: FieldScale) -> Octets:
    return commands(by, by.fields(*(column(value) for value in values)))


@pytest.mark.parametrize(("values", "expected"), GOLDEN.values(), ids=GOLDEN)
def test_golden_commands(values: tuple[float, ...], expected: str) -> None:
    assert encoded(values, scale()).tobytes() == bytes.fromhex(expected)


def test_zero_comes_out_half_a_count_below() -> None:
    by = scale()
    reply = np.array([[7, 0x7F, 0xFF, 0x7F, 0xF7, 0xFF, 0, 0]], np.uint8)
    position, velocity, torque = by.values(unpack(reply), np.array([0]))[:, 0]
    assert position == pytest.approx(-0.00019, abs=5e-6)
    assert velocity == pytest.approx(-0.0073, abs=5e-5)
    assert torque == pytest.approx(-0.0024, abs=5e-5)
    least = (2 * 12.5 / 65535, 2 * 30 / 4095, 2 * 10 / 4095)
    assert least == pytest.approx((0.00038, 0.0147, 0.0049), rel=5e-3)


def exact(value: float, most: float, bits: int, *, gain: bool) -> Fraction:
    """The field before truncation, in exact arithmetic."""
    lower = Fraction(0) if gain else -Fraction(most)
    return (Fraction(value) - lower) * (2**bits - 1) / (Fraction(most) - lower)


@given(st.sampled_from(sorted(MODELS)), st.tuples(*[st.floats(0.0, 1.0)] * 5), st.sampled_from((BITS, WIDE)))
@examples(100)
def test_each_field_is_truncated_and_within_one_count(
    name: str, shares: tuple[float, ...], bits: tuple[int, ...]
) -> None:
    model = MODELS[name]
    most = (
        12.5 if np.isnan(model.position) else model.position,
        model.velocity,
        model.kp,
        model.kd,
        model.torque,
    )
    span = ranges(1, most[0], most[1], most[4])
    span.kp[:] = most[2]
    span.kd[:] = most[3]
    values = [
        share * top if field in (2, 3) else (2.0 * share - 1.0) * top
        for field, (share, top) in enumerate(zip(shares, most, strict=True))
    ]
    fields = FieldScale("can0", [7], span, bits, TOLD).fields(*(column(value) for value in values))[:, 0]
    for number, (field, value, top, width) in enumerate(zip(fields, values, most, bits, strict=True)):
        wanted = exact(value, top, width, gain=number in (2, 3))
        assert 0 <= int(field) <= 2**width - 1
        # Never rounded up; the arithmetic of floats may lose a count that is exactly whole.
        assert wanted - 1 - Fraction(1, 10**6) <= int(field) <= floor(wanted + Fraction(1, 10**6))


@given(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFFF), st.integers(0, 0xFFF)))
def test_a_reply_holds_its_three_fields(fields: tuple[int, int, int]) -> None:
    position, velocity, torque = fields
    word = position << 40 | velocity << 28 | torque << 16 | 0x07 << 56 | 0xABCD
    data = np.frombuffer(word.to_bytes(8, "big"), np.uint8).reshape(1, 8)
    assert tuple(unpack(data)[:, 0]) == fields


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFFF))
@examples(50)
def test_a_reported_position_can_be_commanded_within_one_count(position: int, velocity: int) -> None:
    by = scale()
    told = by.values(np.array([[position], [velocity], [0]], np.float64), np.array([0]))[:, 0]
    fields = by.fields(*(column(value) for value in (told[0], told[1], 0.0, 0.0, 0.0)))[:, 0]
    assert position - 1 <= int(fields[0]) <= position
    assert velocity - 1 <= int(fields[1]) <= velocity


def ends(field: int) -> tuple[float, float]:
    most = (12.5, 30.0, 500.0, 5.0, 10.0)[field]
    return (0.0 if field in (2, 3) else -most), most


@pytest.mark.parametrize("field", range(5), ids=NAMES)
def test_both_ends_are_held_and_what_is_beyond_is_refused(field: int) -> None:
    by = scale()
    lower, upper = ends(field)
    for value, expected in ((lower, 0), (upper, 2 ** BITS[field] - 1)):
        values = [0.0] * 5
        values[field] = value
        assert int(by.fields(*(column(one) for one in values))[field, 0]) == expected
    for value in (np.nextafter(lower, -np.inf), np.nextafter(upper, np.inf), np.nan, np.inf, -np.inf):
        values = [0.0] * 5
        values[field] = value
        with pytest.raises(WireRangeError, match=rf"can0: id 7: {NAMES[field]} ") as refused:
            by.fields(*(column(one) for one in values))
        assert (refused.value.lower, refused.value.upper) == (lower, upper)


def test_the_upper_end_of_every_model_is_the_highest_count() -> None:
    for name, model in MODELS.items():
        span = ranges(1, 12.5 if np.isnan(model.position) else model.position, model.velocity, model.torque)
        for bits in (BITS, WIDE):
            by = FieldScale("can0", [7], span, bits, TOLD)
            fields = by.fields(span.position, span.velocity, span.kp, span.kd, span.torque)[:, 0]
            assert [int(field) for field in fields] == [2**width - 1 for width in bits], name


def test_a_command_that_would_be_an_order_is_refused() -> None:
    by = scale()
    with pytest.raises(WireRangeError, match="torque field"):
        encoded((12.5, 30.0, 500.0, 5.0, 10.0 - 1.5 * 20 / 4095), by)  # would be FF x7 FE: zero here
    assert encoded((12.5, 30.0, 500.0, 5.0, 9.9), by)[0, 7] < 0xF0
    assert is_special_frame(frame(7, "FF FF FF FF FF FF FF FC")).all()
    assert not is_special_frame(frame(7, "FF FF FF FF FF FF FF EF")).any()


def test_a_refused_command_is_named_with_the_torque_that_it_may_have() -> None:
    """The second of two: everything at its upper end, its torque field at the first that is an order."""
    by = FieldScale("can0", [3, 9], ranges(2), BITS, TOLD)
    fields = np.array([[1, 0xFFFF], [1, 0xFFF], [1, 0xFFF], [1, 0xFFF], [1, 0xFF0]], np.uint64)
    with pytest.raises(WireRangeError, match="torque field") as refused:
        commands(by, fields)
    found = refused.value
    assert (found.id, found.value, found.lower, found.upper) == (9, 0xFF0, 0.0, 0xFEF)
    fields[4, 1] = 0xFEF
    assert commands(by, fields)[1].tobytes() == bytes.fromhex("FF FF FF FF FF FF FF EF")
    assert is_special_frame(frame(7, "FF FF FF FF FF FF FF F0")).all()


def test_gains_span_500_and_5_in_all_frames() -> None:
    assert (KP, KD) == (500.0, 5.0)
    assert WIDE == (16,) * 5


def test_the_one_outside_is_named_and_nothing_is_made() -> None:
    by = FieldScale("can0", [3, 9], ranges(2), BITS, TOLD)
    zero: Floats = np.zeros(2)
    with pytest.raises(WireRangeError, match=r"can0: id 9: velocity 30.1 outside -30.0..30.0"):
        by.fields(zero, column(0.0, 30.1), zero, zero, zero)


@pytest.mark.parametrize("wrong", [(1,), (3,), (2, 1)])
def test_values_of_another_shape_are_an_error(wrong: tuple[int, ...]) -> None:
    by = FieldScale("can0", [3, 9], ranges(2), BITS, TOLD)
    with pytest.raises(ValueError):
        by.fields(np.zeros(wrong), *[np.zeros(2)] * 4)
    with pytest.raises(ValueError, match=r"can0: \(5, .* values for \(5, 2\) fields"):
        by.fields(*[np.zeros(wrong)] * 5)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_a_range_must_be_a_positive_number(bad: float) -> None:
    with pytest.raises(ValueError, match="range of velocity"):
        scale(velocity=bad)


def test_the_first_range_that_is_none_is_named() -> None:
    """A range below 1 is one."""
    span = ranges(3, 0.5, 0.5, 0.5)
    span.velocity[1] = span.torque[2] = 0.0
    with pytest.raises(ValueError, match=r"range of velocity of actuator 1 \(from 0\) is 0.0"):
        FieldScale("can0", [3, 9, 5], span, BITS, TOLD)


def test_the_first_value_outside_is_named() -> None:
    by = FieldScale("can0", [3, 9], ranges(2), BITS, TOLD)
    zero: Floats = np.zeros(2)
    with pytest.raises(WireRangeError, match=r"can0: id 9: velocity 40.0 ") as refused:
        by.fields(zero, column(0.0, 40.0), zero, zero, column(11.0, 0.0))
    assert refused.value.id == 9


def test_positions_are_read_from_motion_commands_alone() -> None:
    by = FieldScale("can0", [3, 9], ranges(2), BITS, TOLD)
    both = np.concatenate([frame(3, "FF FF 00 00 00 00 00 00"), frame(9, "00 00 00 00 00 00 00 00")])
    rows = np.array([0, 1])
    for motion, wanted in (
        ([True, True], [12.5, -12.5]),
        ([True, False], [12.5, np.nan]),
        ([False, True], [np.nan, -12.5]),
        ([False, False], [np.nan, np.nan]),
    ):
        found = by.decode_commanded_position(both, rows, np.array(motion))
        assert found.tolist() == pytest.approx(wanted, nan_ok=True)


@pytest.mark.parametrize("count", [0, 1, 24, 63, 64, 65, 200])
def test_any_number_of_actuators_is_packed_alike(count: int) -> None:
    by = FieldScale("can0", range(count), ranges(count), BITS, TOLD)
    wanted = bytes.fromhex(GOLDEN["everything"][1])
    made = commands(by, by.fields(*(np.full(count, value) for value in GOLDEN["everything"][0])))
    assert made.tobytes() == wanted * count
    assert unpack(np.zeros((count, 8), np.uint8)).shape == (3, count)


def test_the_position_of_a_command_is_read_back() -> None:
    by = scale()
    asked = by.position(encoded(GOLDEN["everything"][0], by), np.array([0]))
    assert asked[0] == pytest.approx(-pi, abs=25 / 65535)
    assert asked[0] <= -pi
