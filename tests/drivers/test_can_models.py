"""CAN models by name, and the codecs that are made of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.can_codec_frames import column, decode_all, noise, ranges
from tests.support.examples import examples
from twind_drivers.bus import WireRangeError
from twind_drivers.can.actuator_family import ActuatorFamily, ValuelessCommand
from twind_drivers.can.can_models import MODELS, model, number_of
from twind_drivers.can.codec_factory import FAMILIES, apart, make, ranges_of
from twind_drivers.can.damiao_codec import DamiaoCodec
from twind_drivers.can.odrive_codec import ODriveCodec
from twind_drivers.ports.frame import EXTENDED, STANDARD_MASK

# As the project's facts have them: rad, rad/s, N·m.
TABLE = {
    "DM3507": (12.5, 30, 10),
    "DM4310": (12.5, 30, 10),
    "DM4310-48V": (12.5, 50, 10),
    "DM4340": (12.5, 8, 28),
    "DM4340-48V": (12.5, 10, 28),
    "DM6006": (12.5, 45, 20),
    "DM8006": (12.5, 45, 40),
    "DM8009": (12.5, 45, 54),
    "DM10010L": (12.5, 25, 200),
    "DM10010": (12.5, 20, 200),
    "DMH3510": (12.5, 280, 1),
    "DMH6215": (12.5, 45, 10),
    "DMG6220": (12.5, 45, 10),
    "AK70-10": (12.5, 50, 25),
    "AK80-64": (12.5, 8, 144),
    "RS00": (12.57, 33, 14),
    "RS01": (12.5, 44, 17),
    "RS02": (12.57, 33, 20),
    "RS03": (12.57, 33, 60),
    "RS04": (12.57, 33, 120),
    "RS05": (12.57, 50, 5.5),
    "EL05": (12.57, 50, 6),
}


def test_the_field_ranges_of_a_model_are_those_of_its_source() -> None:
    found = {name: (model(name).position, model(name).velocity, model(name).torque) for name in TABLE}
    assert found == TABLE


def test_numbers_are_for_ever() -> None:
    """Calibrations hold them: a number that changes makes a robot another one."""
    numbers = {name: number_of(name) for name in MODELS}
    assert len(set(numbers.values())) == len(numbers)
    assert min(numbers.values()) > 0xFFFF  # no serial servo has one like it
    assert [numbers[name] for name in ("DM3507", "DM4340", "DMG6220")] == [71001, 71004, 71013]
    assert [numbers[name] for name in ("AK70-10", "AK80-9", "RS00", "EL05")] == [72001, 72005, 73000, 73006]
    assert [numbers[name] for name in ("ODrive", "ODrive-S1", "ODrive-Pro")] == [74001, 74002, 74003]


@pytest.mark.parametrize(
    ("wrong", "near"),
    [
        ("DM4342", "DM4340"),
        ("dm4340", "DM4340"),
        ("AK70-11", "AK70-10"),
        ("odrive", "ODrive"),
        ("RS-01", "RS01"),
    ],
)
def test_a_wrong_name_lists_the_nearest(wrong: str, near: str) -> None:
    with pytest.raises(KeyError, match=f"{wrong}.*{near}"):
        model(wrong)


def test_a_name_that_is_near_nothing_lists_all() -> None:
    with pytest.raises(KeyError, match=r"known are DM3507.*ODrive-Pro"):
        model("?")


def test_every_model_makes_a_codec_of_its_family() -> None:
    for name, found in MODELS.items():
        spans = ranges_of([found])
        if np.isnan(found.position):
            with pytest.raises(ValueError, match="range of position"):
                make(found.family, "can0", [1], [name])
            spans = ranges(1)
        family = make(found.family, "can0", [1], [name], ranges=spans)
        assert (family.name, family.ids) == (found.family, (1,))
        assert family.ranges.velocity[0] == spans.velocity[0]
        assert (family.watchdog is not None) == (found.family in ("damiao", "robstride"))
        assert set(family.identity) <= set(family.parameters)
    assert {found.family for found in MODELS.values()} == set(FAMILIES)


def test_large_robstrides_have_wider_gains() -> None:
    for name in ("RS03", "RS04", "RS06"):
        assert (model(name).kp, model(name).kd) == (5000.0, 100.0)
    assert (model("RS01").kp, model("RS01").kd) == (500.0, 5.0)


def test_a_damiao_has_its_id_and_10h_as_default_feedback_id() -> None:
    beside = make("damiao", "can0", [1, 2], ["DM4310", "DM4340"])
    given = make("damiao", "can0", [1, 2], ["DM4310", "DM4340"], feedback_ids=[0x21, 0x21])
    assert isinstance(beside, DamiaoCodec)
    assert list(beside.ranges.velocity) == [30.0, 8.0]
    for id, family in ((0x12, beside), (0x21, given)):
        heard = np.zeros(1, beside.make_position_request().dtype)
        heard["id"] = id
        heard["size"] = 8
        heard["data"][0, 0] = 0x12
        heard["data"][0, 1] = 0x7F
        assert list(family.feedback(heard)[0].rows) == [1]


def test_the_host_id_reaches_a_robstride() -> None:
    family = make("robstride", "can0", [1], ["RS01"], host=0x1F)
    assert int(family.make_position_request()["id"][0]) & 0x1FFF_FFFF == 0x11001F01


def test_the_model_name_selects_the_odrive_board() -> None:
    family = make("odrive", "can0", [1, 2], ["ODrive", "ODrive-S1"], ranges=ranges(2))
    assert isinstance(family, ODriveCodec)
    family.read(0, family.parameters["motor_error"])
    with pytest.raises(ValueError, match="node 2"):
        family.read(1, family.parameters["motor_error"])


def test_inconsistent_models_and_families_are_refused() -> None:
    with pytest.raises(KeyError, match="no CAN family 'moteus': known are damiao"):
        make("moteus", "can0", [1], ["DM4310"])
    with pytest.raises(ValueError, match="id 2 is a AK70-10, which is cubemars, not damiao"):
        make("damiao", "can0", [1, 2], ["DM4310", "AK70-10"])
    with pytest.raises(ValueError, match="1 models for 2"):
        make("damiao", "can0", [1, 2], ["DM4310"])


@pytest.mark.parametrize("family", FAMILIES)
def test_a_bus_without_one_of_them_is_no_special_case(family: str) -> None:
    empty = make(family, "can0", [], [])
    nothing: np.ndarray[tuple[int], np.dtype[np.float64]] = np.zeros(0)
    assert len(empty.make_position_request()) == 0
    assert len(empty.command(nothing, nothing, nothing, nothing, nothing)) == 0
    assert len(empty.gains(nothing, nothing)) == 0
    strange = np.zeros(3, empty.command(nothing, nothing, nothing, nothing, nothing).dtype)
    assert not empty.feedback(strange)[1].any()
    assert not empty.decode_register_replies(strange)[1].any()
    assert list(empty.commanded_rows(strange)) == [-1, -1, -1]


def of(family: str, *ids: int, masters: tuple[int, ...] | None = None) -> ActuatorFamily:
    name = {"damiao": "DM4310", "cubemars": "AK70-10", "robstride": "RS01", "odrive": "ODrive"}[family]
    spans = ranges(len(ids))
    return make(family, "can0", ids, [name] * len(ids), ranges=spans, feedback_ids=masters)


def test_families_share_a_bus_while_their_ids_differ() -> None:
    apart("can0", [of("damiao", 1, 2), of("cubemars", 3), of("robstride", 1), of("odrive", 2)])
    apart("can0", [])


@pytest.mark.parametrize(
    ("one", "other", "shared"),
    [
        (("damiao", 1), ("cubemars", 1), "0x1"),
        (("damiao", 1), ("cubemars", 0x11), "0x11"),  # its master id
        (("damiao", 1), ("odrive", 0), "0x1"),
        (("damiao", 1), ("odrive", 8), "0x101"),  # its position-velocity mode
        (("damiao", 1), ("odrive", 0x3F), "0x7ff"),  # requests of registers
        (("cubemars", 0x68), ("odrive", 3), "0x68"),
        (("cubemars", 0x68), ("odrive", 0), "0x0"),
    ],
)
def test_families_that_share_a_frame_id_are_refused(
    one: tuple[str, int], other: tuple[str, int], shared: str
) -> None:
    with pytest.raises(ValueError, match=f"can0: {one[0]} .* and {other[0]} .* frame id {shared}:"):
        apart("can0", [of(*one), of(*other)])


@pytest.mark.parametrize("family", ["damiao", "cubemars", "odrive"])
def test_every_frame_of_ours_has_an_id_that_is_claimed(family: str) -> None:
    codec = of(family, 1, 2)
    zero = np.zeros(2)
    made = [
        codec.make_position_request(),
        codec.command(zero, zero, zero, zero, zero),
        codec.gains(zero + 1, zero + 1),
    ]
    made += [
        codec.encode_valueless_command(0, what)
        for what in (ValuelessCommand.ENABLE, ValuelessCommand.DISABLE, ValuelessCommand.ZERO)
    ]
    made += [codec.read(0, parameter) for parameter in codec.parameters.values()]
    ids = {int(id) & STANDARD_MASK for frames in made for id in frames["id"]}
    assert ids <= codec.claims


@pytest.mark.parametrize(
    ("family", "what"),
    [("cubemars", "CLEAR"), ("cubemars", "REBOOT"), ("damiao", "REBOOT"), ("robstride", "REBOOT")],
)
def test_an_order_that_a_family_lacks_is_refused(family: str, what: str) -> None:
    with pytest.raises(ValueError, match=f"id 2: a .* has no {what.lower()}"):
        of(family, 1, 2).encode_valueless_command(1, ValuelessCommand[what])


@pytest.mark.parametrize(
    ("family", "ids"),
    [
        *(("cubemars", ids) for ids in ((1, 1), (0, 1), (1, 0x100))),
        *(("odrive", ids) for ids in ((1, 1), (0, 0x40), (-1, 1))),
    ],
)
def test_ids_must_differ_and_fit_their_field(family: str, ids: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=f"{family} id"):
        of(family, *ids)


@pytest.mark.parametrize("family", ["cubemars", "damiao", "robstride"])
def test_a_torque_beyond_its_field_is_refused(family: str) -> None:
    zero = np.zeros(2)
    with pytest.raises(WireRangeError, match=r"can0: id 2: torque 10.01 outside -10.0..10.0"):
        of(family, 1, 2).command(zero, zero, zero, zero, column(0.0, 10.01))


NEAR = {
    "damiao": (1, 2, 0x11, 0x12, 0x7FF, 0x101, 0x202),
    "cubemars": (0, 1, 2),
    "robstride": tuple(
        EXTENDED | kind << 24 | sender << 8 | target
        for kind in (0, 1, 2, 3, 4, 6, 0x11, 0x12, 0x15, 0x18)
        for sender, target in ((1, 0xFD), (2, 0xFD), (0xFD, 1), (0xFD, 2), (1, 0xFE))
    ),
    "odrive": tuple(node << 5 | command for node in (1, 2) for command in range(32)),
}


@pytest.mark.parametrize("family", FAMILIES)
@given(st.data())
@examples(30)
def test_no_frames_whatever_make_a_decoder_raise(family: str, data: st.DataObject) -> None:
    decode_all(of(family, 1, 2), data.draw(noise(NEAR[family])))
