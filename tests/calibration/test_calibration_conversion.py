"""Foreign measurements are converted exactly to the count, or refused with a reason: nothing is guessed."""

import contextlib
import json
import re
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.command_line.verb import Rejected
from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import JointCalibration
from twind.config.counts import tick_range
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError
from twind_calibration.calibrating.calibration_actuators import slots
from twind_calibration.calibrating.calibration_conversion import (
    DYNAMIXEL,
    FEETECH,
    ImportResult,
    convert_entry,
    of_motor,
    of_registers,
)
from twind_calibration.calibrating.lerobot_file import FIELDS, LeRobotMotor, read
from twind_calibration.calibrating.motor_matching import matched, read_map
from twind_drivers.dynamixel.dynamixel_models import MAX_OFFSET

ROBOT = load_robot("h24")
SLOTS = slots(ROBOT)
KNEE = next(slot for slot in SLOTS if slot.name == "l_knee")
TURN = 4096
BEYOND = re.compile("cross its encoder's seam|leave the counts")  # of its limits: no mode position then
DEVICE = DeviceRecord(1020, 46, None, 0, 0, 3, 0, 4095)


def device(offset: int = 0, drive: int = 0, low: int = 0, high: int = 4095) -> DeviceRecord:
    return replace(DEVICE, homing_offset_ticks=offset, drive_mode=drive, min_ticks=low, max_ticks=high)


def span(slot: Any, zero: int) -> tuple[int, int]:
    """A travel that fits: the described limits, and a little more."""
    low, high = tick_range(slot.joint, zero, slot.lower, slot.upper)
    return low - 40, high + 40


def taken(result: ImportResult) -> JointCalibration:
    assert result.entry is not None, result.wrong
    return result.entry


def refused(result: ImportResult) -> str:
    assert result.entry is None
    return "; ".join(result.wrong)


# ------------------------------------------------------------------------------------------- folded in

OFFSETS = st.integers(-MAX_OFFSET, MAX_OFFSET)


@given(st.sampled_from(SLOTS), st.integers(0, 4095), OFFSETS, OFFSETS)
def test_a_count_under_one_offset_is_the_same_place_under_another(
    slot: Any, zero: int, then: int, now: int
) -> None:
    """`zero` is of the encoder itself: what it tells is that and the offset, whichever is written."""
    low, high = span(slot, zero + then)
    motor = LeRobotMotor("m", slot.joint.id, 0, then, low, high)
    folded = convert_entry(slot, of_motor(motor, DYNAMIXEL), device(now), zero + then)
    assume(not BEYOND.search("; ".join(folded.wrong)))
    entry = taken(folded)
    assert (entry.zero_ticks - (zero + now)) % TURN == 0
    assert entry.sweep_ticks[0] - entry.zero_ticks == low - (zero + then)
    assert entry.sweep_ticks[1] - entry.zero_ticks == high - (zero + then)
    assert entry.device == device(now)
    assert (entry.method, entry.captures, entry.sign) == ("import", 1, slot.joint.sign)


@given(st.integers(1500, 2500), OFFSETS)
def test_an_offset_equal_to_the_servos_needs_no_make_option(zero: int, offset: int) -> None:
    low, high = span(KNEE, zero)
    motor = LeRobotMotor("m", KNEE.joint.id, 0, offset, low, high)
    folded = convert_entry(KNEE, of_motor(motor, None), device(offset), zero)
    assume(not BEYOND.search("; ".join(folded.wrong)))
    assert taken(folded).zero_ticks == zero


def test_the_middle_of_the_travel_may_be_the_zero() -> None:
    slot = next(slot for slot in SLOTS if slot.lower == -slot.upper)
    low, high = span(slot, 2048)
    entry = taken(
        convert_entry(slot, of_motor(LeRobotMotor("m", slot.joint.id, 0, 0, low, high), None), device(), None)
    )
    assert abs(entry.zero_ticks - 2048) <= 1


def test_the_servos_own_limits_are_its_travel_unless_a_sweep_is_recorded() -> None:
    low, high = span(KNEE, 2048)
    limited = device(100, low=low, high=high)
    assert taken(convert_entry(KNEE, of_registers(KNEE, limited, None), limited, 2048)).sweep_ticks == (
        low,
        high,
    )
    swept = (low - 5 + TURN, high + 5 + TURN)  # of a sweep it does not matter on which turn it was
    entry = taken(convert_entry(KNEE, of_registers(KNEE, limited, swept), limited, 2048))
    assert (entry.sweep_ticks, entry.zero_ticks) == ((low - 5, high + 5), 2048)


ARM = load_robot("so101")
LIFT = next(slot for slot in slots(ARM) if slot.name == "shoulder_lift")
STS = DeviceRecord(777, 310, None, 0, 0, 0, 0, 4095)
STS_OFFSETS = st.integers(-2047, 2047)


@given(st.integers(0, 4095), STS_OFFSETS, STS_OFFSETS)
def test_a_feetech_count_is_the_encoder_less_the_offset(encoder: int, then: int, now: int) -> None:
    """Exact to the count; `encoder`: its place at angle 0. Counts are 0 to 4095 with any offset."""
    zero = (encoder - then) % TURN
    low, high = span(LIFT, zero)
    folded = convert_entry(
        LIFT,
        of_motor(LeRobotMotor("m", LIFT.joint.id, 0, then, low, high), FEETECH),
        replace(STS, homing_offset_ticks=now),
        zero,
    )
    shown = (encoder - now) % TURN
    ends = tick_range(LIFT.joint, shown, LIFT.lower, LIFT.upper)
    if ends[0] > 40 and ends[1] < 4055:
        entry = taken(folded)
        assert entry.zero_ticks == shown
        assert entry.sweep_ticks == span(LIFT, shown)
    elif ends[0] < 0 or ends[1] > 4095:
        assert BEYOND.search(refused(folded))


def test_a_lerobot_file_of_an_so101_is_taken_as_it_is() -> None:
    """LeRobot sets the offset so that the middle reads 2047, and the whole turn for a joint without stops."""
    motors = read(
        json.dumps(
            {
                "shoulder_lift": {
                    "id": 2,
                    "drive_mode": 0,
                    "homing_offset": -1203,
                    "range_min": 850,
                    "range_max": 3240,
                },
                "wrist_roll": {
                    "id": 5,
                    "drive_mode": 0,
                    "homing_offset": 77,
                    "range_min": 0,
                    "range_max": 4095,
                },
            }
        ).encode(),
        "arm.json",
    )
    now = replace(STS, homing_offset_ticks=-1203, min_ticks=850, max_ticks=3240)
    entry = taken(convert_entry(LIFT, of_motor(motors["shoulder_lift"], None), now, 2047))
    assert (entry.zero_ticks, entry.sweep_ticks) == (2047, (850, 3240))
    roll = next(slot for slot in slots(ARM) if slot.name == "wrist_roll")
    whole = of_motor(motors["wrist_roll"], None)
    assert "a whole turn" in refused(convert_entry(roll, whole, replace(STS, homing_offset_ticks=77), 2047))


# ------------------------------------------------------------------------------------------- refused


def knee(offset: int = 0, drive: int = 0, travel: tuple[int, int] | None = None) -> LeRobotMotor:
    return LeRobotMotor("m", KNEE.joint.id, drive, offset, *(travel or span(KNEE, 2048)))


@pytest.mark.parametrize(
    ("motor", "make", "now", "why"),
    [
        (knee(offset=100), None, device(), "`--make dynamixel` folds it in"),
        (knee(offset=100), FEETECH, device(), "no feetech servo"),
        (knee(), FEETECH, device(), "no feetech servo"),
        (knee(offset=1500), DYNAMIXEL, device(), "in some operating modes and not in others"),
        (knee(offset=1025), None, device(1025), "position mode ignores it"),
        (knee(drive=1), DYNAMIXEL, device(), "drive_mode is 1, that of the servo is 0"),
        (knee(), DYNAMIXEL, device(drive=1), "drive_mode is 0, that of the servo is 1"),
        (knee(travel=(0, 4095)), None, device(), "a whole turn"),
        (knee(travel=(2000, 2100)), None, device(), "less than 60 %"),
        (knee(travel=(1400, 2700)), None, device(), "beyond its travel"),
    ],
)
def test_an_unusable_foreign_value_is_refused_with_the_reason(
    motor: LeRobotMotor, make: str | None, now: DeviceRecord, why: str
) -> None:
    assert why in refused(convert_entry(KNEE, of_motor(motor, make), now, 2048))


def test_limits_as_delivered_are_no_travel() -> None:
    said = refused(convert_entry(KNEE, of_registers(KNEE, device(), None), device(), 2048))
    assert "a whole turn, as delivered: `twindctl calibrate sweep` first" in said


def test_a_travel_that_is_too_long_needs_wide_and_a_too_short_one_is_refused() -> None:
    low, high = span(KNEE, 2048)
    long = of_motor(knee(travel=(low - 500, high + 500)), None)
    short = of_motor(knee(travel=(2000, 2100)), None)
    assert "`--wide` takes it" in refused(convert_entry(KNEE, long, device(), 2048))
    taken(convert_entry(KNEE, long, device(), 2048, wide=True))
    refused(convert_entry(KNEE, short, device(), 2048, wide=True))


def test_a_drive_mode_s_other_bits_do_not_count() -> None:
    taken(convert_entry(KNEE, of_motor(knee(drive=4), None), device(drive=0), 2048))
    taken(convert_entry(KNEE, of_motor(knee(drive=5), None), device(drive=1), 2048))


def test_a_can_actuator_has_nothing_of_it() -> None:
    mixed = next(slot for slot in slots(load_robot("h24-mixed")) if slot.joint.type.ticks_per_turn != TURN)
    assert "say nothing of it" in refused(convert_entry(mixed, of_motor(knee(), None), device(), 2048))


# ------------------------------------------------------------------------------------------- the file

GOOD = {"id": 1, "drive_mode": 0, "homing_offset": -12, "range_min": 700, "range_max": 3200}


def file(content: Any) -> bytes:
    return json.dumps(content).encode()


def test_a_file_is_read_whole() -> None:
    assert read(file({"shoulder": GOOD}), "a.json") == {
        "shoulder": LeRobotMotor("shoulder", 1, 0, -12, 700, 3200)
    }


def import_message(data: bytes) -> str:
    with pytest.raises(Rejected) as caught:
        read(data, "a.json")
    assert str(caught.value).startswith("a.json: ")
    return str(caught.value)


@pytest.mark.parametrize(
    ("value", "word"),
    [
        ("12", "the text '12'"),
        (12.0, "12.0"),
        (True, "true"),
        (None, "null"),
        ([1], "a list"),
        ({}, "object"),
    ],
)
@pytest.mark.parametrize("field", list(FIELDS))
def test_a_non_integer_field_is_refused_by_its_path(field: str, value: Any, word: str) -> None:
    said = import_message(file({"shoulder": GOOD | {field: value}}))
    assert f"shoulder.{field} is" in said
    assert word in said


@pytest.mark.parametrize("number", ["Infinity", "-Infinity", "NaN", "1e999", "9" * 30])
def test_numbers_that_json_does_not_have_are_refused(number: str) -> None:
    text = file({"shoulder": GOOD}).replace(b"3200", number.encode())
    assert "is not JSON" in import_message(text) or "beyond" in import_message(text)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "Expecting value"),
        (b"[]", "a list where an object of motors must be"),
        (b"{}", "an object where an object of motors must be"),
        (b"3", "3 where an object of motors must be"),
        (file({"homing_offset": [1, 2], "motor_names": ["a", "b"]}), "lists, in whose order alone"),
        (file({"shoulder": [1, 0, 0, 1, 2]}), "lists, in whose order alone"),
        (file({"shoulder": 3}), "shoulder: 3 where an object must be"),
        (file({"shoulder": GOOD | {"gain": 3}}), "shoulder.gain cannot be expressed"),
        (file({"shoulder": {"id": 3}}), "shoulder.drive_mode is missing"),
        (file({"shoulder": GOOD | {"range_min": 3200}}), "range_min 3200 is not below range_max 3200"),
        (file({"shoulder": GOOD | {"id": 253}}), "shoulder.id is 253, outside 0..252"),
        (file({"shoulder": GOOD | {"range_max": 1 << 40}}), "outside"),
        (b'{"a": {}, "a": {}}', "stands twice"),
        (b"\xff\xfe", "UTF-8"),
    ],
)
def test_another_shape_is_refused_with_words(data: bytes, why: str) -> None:
    assert why in import_message(data)


@examples(40)
@given(st.binary(max_size=60) | st.recursive(st.none() | st.integers() | st.text(), st.lists).map(file))
def test_any_foreign_file_is_read_or_refused(data: bytes) -> None:
    with contextlib.suppress(Rejected):
        assert all(isinstance(each, LeRobotMotor) for each in read(data, "a.json").values())


# ------------------------------------------------------------------------------------------- whose it is


def motor(name: str, id: int) -> LeRobotMotor:
    return LeRobotMotor(name, id, 0, 0, 700, 3200)


def test_motors_are_matched_by_id_or_by_a_map() -> None:
    motors = {"a": motor("a", 3), "b": motor("b", 1)}
    by_id = {slot.joint.id: slot.name for slot in SLOTS}
    assert {name: each.name for name, each in matched(motors, SLOTS, None).items()} == {
        by_id[3]: "a",
        by_id[1]: "b",
    }
    names = read_map(f"a: {by_id[3]}\nb: null\n", "map")
    assert list(matched(motors, SLOTS, names)) == [by_id[3]]


@pytest.mark.parametrize(
    ("names", "why"),
    [
        ({"a": "l_knee"}, "and l_knee has id"),
        ({"a": "l_kneee"}, "nearest: l_knee"),
        ({}, "the map does not name a"),
        ({"a": None, "c": None}, "the map names c, which is no motor"),
    ],
)
def test_a_map_that_does_not_fit_is_refused(names: dict[str, str | None], why: str) -> None:
    with pytest.raises(Rejected, match=why):
        matched({"a": motor("a", 1)}, SLOTS, names)


def test_an_unassigned_ambiguous_or_repeated_id_is_refused() -> None:
    with pytest.raises(Rejected, match="which is no actuator's: `--map FILE`"):
        matched({"a": motor("a", 200)}, SLOTS, None)
    with pytest.raises(Rejected, match=r"a and b|b and a"):
        matched({"a": motor("a", 1), "b": motor("b", 1)}, SLOTS, None)
    twin = replace(SLOTS[0], name="other", joint=replace(SLOTS[0].joint, bus="right"))
    with pytest.raises(Rejected, match=r"as have .* on bus main and other on bus right"):
        matched({"a": motor("a", 1)}, [*SLOTS, twin], None)


@pytest.mark.parametrize("text", ["a: 3\n", "a: [x]\n", "- a\n", "a: b\na: c\n", "a: *x\n"])
def test_a_map_that_is_no_map_is_refused(text: str) -> None:
    with pytest.raises(ConfigError):
        read_map(text, "map")
