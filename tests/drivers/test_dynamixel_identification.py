"""Identification: who is there, with what settings, and whether the fast read may be used."""

from collections.abc import Sequence
from contextlib import suppress

import pytest

from tests.support.dynamixel_responder import Servos, Wire
from twind_drivers.bus import IdentifiedDevice, PingRequest, ReadRequest
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel.dynamixel_identification import supports_fast
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.run_script import perform

IDS = (1, 2, 3, 4, 5, 6)


def reader(servos: Servos, wire: Wire | None = None) -> DynamixelReader:
    return DynamixelReader(
        "main", wire or Wire(servos), IDS, [1020] * len(IDS), baud=1_000_000, return_delay_us=0
    )


def identify(servos: Servos) -> tuple[tuple[IdentifiedDevice, ...], DynamixelReader]:
    bus = reader(servos)
    return perform(bus, bus.identify(), FakeClock()), bus


def test_every_device_is_found_with_its_settings() -> None:
    servos = Servos(IDS)
    servos.put(3, 20, -700, 4)
    servos.put(3, 9, 250, 1)
    servos.put(3, 60, 1, 1)
    servos.put(3, 48, 3500, 4)
    devices, bus = identify(servos)
    assert [each.id for each in devices] == list(IDS)
    third = devices[2]
    assert (third.model_number, third.model_name, third.firmware) == (1020, "XM430-W350", 45)
    wanted = {
        "homing_offset": -700,
        "return_delay_time": 250,
        "startup_configuration": 1,
        "max_position_limit": 3500,
        "operating_mode": 3,
        "status_return_level": 2,
    }
    assert wanted.items() <= third.settings.items()
    assert bus.fast


def test_missing_ids_are_absent_and_disable_the_fast_read() -> None:
    servos = Servos(IDS)
    servos.silent = {2, 5}
    devices, bus = identify(servos)
    assert [each.id for each in devices] == [1, 3, 4, 6]
    assert not bus.fast


def test_a_single_lost_packet_is_not_a_missing_device() -> None:
    servos = Servos(IDS)
    wire = Wire(servos)
    count = [0]

    def lose_every_third(reply: bytes) -> bytes:
        count[0] += 1
        return b"" if count[0] % 3 == 0 else reply

    wire.change = lose_every_third
    bus = reader(servos, wire)
    devices = perform(bus, bus.identify(), FakeClock())
    assert [each.id for each in devices] == list(IDS)
    assert all("homing_offset" in each.settings for each in devices)


def test_a_device_that_answers_only_pings_has_no_settings() -> None:
    servos = Servos(IDS)
    servos.error = {4: 7}
    servos.memory[4][68] = 0
    wire = Wire(servos)
    silent_reads = servos.answer_packet  # status return level 0: reads stay unanswered
    servos.error = {}

    def answer(each):  # type: ignore[no-untyped-def]
        if each.instruction != 1:
            servos.silent = {4}
        reply = silent_reads(each)
        servos.silent = set()
        return reply

    servos.answer_packet = answer  # type: ignore[method-assign]
    bus = reader(servos, wire)
    devices = perform(bus, bus.identify(), FakeClock())
    assert devices[3].id == 4
    assert devices[3].settings == {}
    assert devices[2].settings != {}


def test_another_model_than_expected_is_reported_as_it_is() -> None:
    servos = Servos(IDS)
    servos.put(2, 0, 1200, 2)
    servos.put(5, 0, 4711, 2)
    devices, bus = identify(servos)
    assert (devices[1].model_name, devices[4].model_name) == ("XL330-M288", None)
    assert devices[4].settings == {}
    assert bus.table(2).model == "XL330-M288"
    assert not bus.fast


@pytest.mark.parametrize(
    ("stem", "least"),
    [
        ("xm430_w350", 45),
        ("xh540_w270", 45),
        ("xl430_w250", 45),
        ("xl330_m288", 46),
        ("ph54_200_s500", 12),
        ("rh_p12_rn", 13),
    ],
)
def test_the_fast_read_begins_with_a_firmware(stem: str, least: int) -> None:
    assert supports_fast(stem, least)
    assert not supports_fast(stem, least - 1)


@pytest.mark.parametrize("stem", ["2xl430_w250", "2xc430_w250", "mx_28", "xl320", "ym070_210_a099"])
def test_some_models_never_have_it(stem: str) -> None:
    assert not supports_fast(stem, 255)


def test_old_firmware_reads_plainly() -> None:
    _, bus = identify(Servos(IDS, firmware=44))
    assert not bus.fast


def transactions(servos: Servos, delay_us: float = 0.0, ids: Sequence[int] = tuple(range(1, 25))) -> int:
    """Count the ticks of an identification: one transaction each."""
    wire = Wire(servos)
    bus = DynamixelReader("main", wire, ids, [1020] * len(ids), baud=1_000_000, return_delay_us=delay_us)
    assert len(perform(bus, bus.identify(), FakeClock())) == len(servos.memory) - len(servos.silent)
    return len(wire.writes)


def test_a_robot_of_24_is_identified_within_half_a_second_of_ticks() -> None:
    """At 100 Hz, beside up to 0.5 s between tries to open: back within 1 s (design 6.4)."""
    assert transactions(Servos(range(1, 25))) <= 18
    assert transactions(Servos(range(1, 25)), delay_us=500.0) <= 40  # as the servos are delivered


def test_every_slice_of_it_fits_beside_a_cycle() -> None:
    servos = Servos(range(1, 25))
    bus = DynamixelReader(
        "main", Wire(servos), range(1, 25), [1020] * 24, baud=1_000_000, return_delay_us=250
    )
    script = bus.identify()
    query = next(script)
    with suppress(StopIteration):
        while True:
            assert isinstance(query, PingRequest | ReadRequest)
            assert bus.span(query) <= 0.002
            bus.begin(query, 0.0)
            bus.feed(0.0)
            query = script.send(bus.answer(0.0))


def test_a_bus_without_power_is_given_up_after_a_few_questions_each() -> None:
    servos = Servos(range(1, 25))
    servos.silent = set(range(1, 25))
    assert transactions(servos) <= 24 * 3


def test_a_swapped_model_is_read_by_its_own_table() -> None:
    servos = Servos(IDS)
    servos.put(2, 0, 2010, 2)  # its torque enable is at 512
    servos.put(2, 512, 1, 1)
    devices, _ = identify(servos)
    assert devices[1].model_name == "PH54-100-S500"
    assert devices[1].settings["torque_enable"] == 1
