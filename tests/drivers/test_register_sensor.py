"""A sensor among servos: what is asked of it when, and which answers count."""

import struct
from collections.abc import Callable

import numpy as np
import pytest

from twind_drivers.bus import ReadRequest, RequestReply
from twind_drivers.register_sensor import Sensor, SensorField

MISSES = 3  # in a row park a sensor
OFTEN = 10  # within a second as well
PROOFS = 2  # short replies in a row after which no older one is under way
FIRST = 0.03  # s, the first pause of a parked one; each is twice the one before, up to ...
PROBE = 1.0  # s
RAREST = 16.0  # s, for one that spoils readings of servos
FIELDS = (SensorField(22, "<i2", 3), SensorField(16, "<i2", 3), SensorField(28, "<f4", 1))
WHOLE = ReadRequest((200,), 16, 16)


def request_reply(*data: bytes) -> RequestReply:
    return RequestReply(dict.fromkeys((200,), data[0]) if data else {}, {}, 0.001, 0)


SOUND = request_reply(struct.pack("<3h3hf", 1, -2, 3, 4, 5, -32768, 0.25))


def test_the_block_that_holds_all_fields_is_read_and_each_found_in_it() -> None:
    sensor = Sensor(200, FIELDS)
    assert sensor.ask(0.0) == WHOLE == sensor.query
    found = sensor.take(SOUND, 0.001)
    assert found is not None
    assert [each.tolist() for each in found] == [[4.0, 5.0, -32768.0], [1.0, -2.0, 3.0], [0.25]]


def test_after_a_miss_another_length_is_asked_until_two_are_answered() -> None:
    """The earlier question may still be answered: a late answer is known by its length."""
    sensor = Sensor(200, FIELDS)
    sensor.ask(0.0)
    assert sensor.take(request_reply(), 0.002) is None
    sizes = []
    for cycle in range(2):
        asked = sensor.ask(0.01 * cycle)
        assert asked is not None
        sizes.append(asked.size)
        assert sensor.take(SOUND, 0.01 * cycle + 0.001) is None, "the late answer, not this one"
    assert len(set(sizes)) == 2 and WHOLE.size not in sizes
    sensor = Sensor(200, FIELDS)
    sensor.ask(0.0)
    sensor.take(request_reply(), 0.002)
    sizes = []
    for tick in range(1, 1 + PROOFS):
        asked = sensor.ask(0.01 * tick)
        assert asked is not None
        sizes.append(asked.size)
        assert sensor.take(request_reply(bytes(asked.size)), 0.01 * tick + 0.001) is None, "proof, no reading"
    assert len(set(sizes)) == PROOFS and WHOLE.size not in sizes
    assert sensor.ask(0.03) == WHOLE


def test_a_late_reply_ends_the_wait_for_it() -> None:
    sensor = Sensor(200, FIELDS)
    sensor.ask(0.0)
    sensor.take(request_reply(), 0.002)
    assert sensor.owes(0.009) and sensor.late(WHOLE.size - 1, 0.009) is False
    assert sensor.late(WHOLE.size, 0.009) is True
    assert not sensor.owes(0.009) and not sensor.late(WHOLE.size, 0.009), "one answer to one question"
    assert sensor.ask(0.01) == WHOLE


def test_the_wait_for_a_late_reply_lasts_as_long_as_its_earlier_delay() -> None:
    """80 ms late once: after the next miss the short answers of 30 ms prove nothing."""
    sensor = Sensor(200, FIELDS)
    sensor.ask(0.0)
    sensor.take(request_reply(), 0.002)
    assert sensor.late(WHOLE.size, 0.08)
    assert sensor.ask(0.1) == WHOLE
    sensor.take(request_reply(), 0.102)
    whole = []
    for tick in range(11, 25):
        asked = sensor.ask(0.01 * tick)
        assert asked is not None
        whole += [0.01 * tick] * (asked == WHOLE)
        sensor.take(request_reply(bytes(asked.size)), 0.01 * tick + 0.001)
    assert whole[0] == pytest.approx(0.19)


def served(sensor: Sensor, seconds: float, fails: Callable[[int], bool], harm: bool = False) -> list[float]:
    """Return the times (s) when it was asked, tick by tick; questions that `fails` names get no answer."""
    asked: list[float] = []
    for tick in range(round(seconds * 100)):
        now = 0.01 * tick
        query = sensor.ask(now)
        if query is None:
            continue
        asked.append(now)
        bad = fails(len(asked))
        sensor.take(request_reply() if bad else request_reply(bytes(query.size)), now + 0.002)
        if bad and harm:
            assert sensor.owes(now + 0.009)
            sensor.spoil(now + 0.009)
    return asked


@pytest.mark.parametrize("every", [2, 3, 5])
def test_a_sensor_that_fails_intermittently_is_parked_by_its_failure_rate(every: int) -> None:
    """A good answer between two failures is no credit."""
    asked = served(Sensor(200, FIELDS), 10.0, lambda count: count % every == 0)
    assert max(np.diff(asked)) > 0.4, "left alone for longer each time"
    assert len(asked) < 600


def test_a_sensor_that_fails_eight_times_a_second_on_a_busy_machine_is_asked_every_time() -> None:
    asked = served(Sensor(200, FIELDS), 10.0, lambda count: count % 12 == 0)
    assert len(asked) == 1000


def test_a_sensor_that_corrupts_a_reading_is_parked_at_once_and_longer_each_time() -> None:
    sensor = Sensor(200, FIELDS)
    asked = served(sensor, 120.0, lambda count: True, harm=True)
    assert len(asked) < 20, "in two minutes"
    assert max(np.diff(asked)) == pytest.approx(RAREST, abs=0.02)
    assert sensor.parked


def test_a_sensor_with_good_replies_for_long_starts_again_with_the_first_pause() -> None:
    sensor = Sensor(200, FIELDS)
    served(sensor, 1.0, lambda count: True, harm=True)
    for tick in range(2000):
        query = sensor.ask(2.0 + 0.01 * tick)
        if query is not None:
            sensor.take(request_reply(bytes(query.size)), 2.0 + 0.01 * tick)
    assert sensor.calm(22.0, 1.0)
    sensor.ask(22.0)
    sensor.take(request_reply(), 22.002)
    sensor.spoil(22.009)
    assert sensor.ask(22.03) is None and sensor.ask(22.05) is not None, "the first pause again"


def test_a_sensor_without_replies_is_asked_at_growing_intervals_up_to_a_second() -> None:
    sensor = Sensor(200, FIELDS)
    asked = []
    for tick in range(1000):
        now = tick * 0.01
        if sensor.ask(now) is not None:
            asked.append(now)
            sensor.take(request_reply(), now + 0.002)
    assert asked[:MISSES] == pytest.approx([0.0, 0.01, 0.02])
    assert sensor.parked
    pauses = np.diff(asked[MISSES - 1 :])
    assert pauses[0] < 0.05 and (np.diff(pauses) > -0.011).all()
    assert pauses[-1] == pytest.approx(PROBE, abs=0.011)
    assert 8 < len(asked) < 20, "in ten seconds"


def test_a_parked_sensor_returns_with_its_first_reply() -> None:
    sensor = Sensor(200, FIELDS)
    for tick in range(20):
        if sensor.ask(tick * 0.01) is not None:
            sensor.take(request_reply(), tick * 0.01)
    assert sensor.parked
    asked = sensor.ask(10.0)
    assert asked is not None
    sensor.take(request_reply(bytes(asked.size)), 10.001)
    assert not sensor.parked
    assert sensor.ask(10.01) == WHOLE and sensor.take(SOUND, 10.011) is not None


def test_a_port_that_was_closed_has_no_answers_on_their_way() -> None:
    sensor = Sensor(200, FIELDS)
    sensor.ask(0.0)
    sensor.forget()
    assert sensor.ask(0.01) == WHOLE


# ------------------------------------------------------------------------------- one question at a time


def miss(sensor: Sensor, now: float) -> ReadRequest:
    """It is asked, and does not answer."""
    query = sensor.ask(now)
    assert query is not None
    sensor.take(request_reply(), now)
    return query


def answer(sensor: Sensor, now: float) -> ReadRequest:
    """It is asked, and answers as it is asked."""
    query = sensor.ask(now)
    assert query is not None
    sensor.take(request_reply(bytes(query.size)), now)
    return query


@pytest.mark.parametrize(
    ("fields", "sizes"),
    [(FIELDS, range(1, 9)), ((SensorField(5, "<i4", 1),), range(1, 4)), ((SensorField(5, "<i2", 1),), [1])],
)
def test_a_shortened_question_has_one_of_eight_lengths_in_turn(
    fields: tuple[SensorField, ...], sizes: list[int]
) -> None:
    sensor = Sensor(200, fields)
    miss(sensor, 10.0)
    assert sensor.late(sensor.query.size, 10.5)  # half a second late: so long nothing is proven
    miss(sensor, 11.0)
    asked = [answer(sensor, 11.0 + 0.01 * tick).size for tick in range(1, 1 + 3 * len(sizes))]
    for begin in range(2 * len(sizes)):
        assert sorted(asked[begin : begin + len(sizes)]) == list(sizes)


def test_a_late_reply_ends_the_wait_for_its_question_and_for_those_before_it() -> None:
    sensor = Sensor(200, FIELDS)
    sizes = [miss(sensor, 1.0).size, miss(sensor, 1.5).size]
    assert sensor.late(sizes[0], 1.6)
    assert sensor.owes(1.6) and sensor.late(sizes[1], 1.7)
    assert not sensor.owes(1.7)
    sizes = [miss(sensor, 3.0).size, miss(sensor, 3.5).size]
    assert sensor.late(sizes[1], 3.6)
    assert sensor.late(sizes[0], 3.7) is False
    assert not sensor.owes(3.7)


@pytest.mark.parametrize(("later", "expected"), [(0.99, True), (1.0, False)])
def test_a_reply_is_expected_for_less_than_a_second(later: float, expected: bool) -> None:
    sensor = Sensor(200, FIELDS)
    miss(sensor, 0.0)
    assert sensor.owes(later) is expected
    assert (answer(sensor, later) == WHOLE) is not expected


def test_short_replies_prove_something_two_in_a_row() -> None:
    sensor = Sensor(200, FIELDS)
    miss(sensor, 0.0)
    answer(sensor, 0.1)
    miss(sensor, 0.2)
    assert answer(sensor, 0.3) != WHOLE
    assert answer(sensor, 0.4) != WHOLE
    assert answer(sensor, 0.5) == WHOLE


def test_two_short_replies_prove_nothing_before_the_longest_delay_has_passed() -> None:
    """In numbers without rounding."""
    sensor = Sensor(200, FIELDS)
    miss(sensor, 8.0)
    assert sensor.late(WHOLE.size, 8.25)
    miss(sensor, 9.0)
    assert answer(sensor, 9.125) != WHOLE
    assert answer(sensor, 9.1875) != WHOLE
    assert answer(sensor, 9.25) == WHOLE


def test_three_misses_in_a_row_park_a_sensor_however_seldom_it_is_asked() -> None:
    sensor = Sensor(200, FIELDS)
    for now in (0.0, 5.0, 10.0):
        assert not sensor.parked
        miss(sensor, now)
    assert sensor.parked


@pytest.mark.parametrize(("last", "parked"), [(0.99, True), (1.0, False)])
def test_ten_misses_within_a_second_park_a_sensor_that_answers_in_between(last: float, parked: bool) -> None:
    sensor = Sensor(200, FIELDS)
    for now in (*(0.1 * count for count in range(OFTEN - 1)), last):
        assert not sensor.parked
        answer(sensor, now)
        miss(sensor, now)
    assert sensor.parked is parked


def test_a_reply_of_another_length_is_a_miss() -> None:
    sensor = Sensor(200, FIELDS)
    for tick in range(MISSES):
        assert sensor.ask(0.1 * tick) is not None
        assert sensor.take(request_reply(bytes(15)), 0.1 * tick) is None
    assert sensor.parked


def probes(sensor: Sensor, now: float, count: int) -> list[float]:
    """Pauses (s) of a parked sensor that answers no probe, to the tenth of a millisecond."""
    pauses = []
    for _ in range(count):
        begin = now
        while sensor.ask(now) is None:
            now += 0.0001
        sensor.take(request_reply(), now)
        pauses.append(now - begin)
    return pauses


def test_each_pause_is_twice_the_one_before() -> None:
    sensor = Sensor(200, FIELDS)
    for tick in range(MISSES):
        miss(sensor, 0.001 * tick)
    wanted = [FIRST, 2 * FIRST, 4 * FIRST, 8 * FIRST, 16 * FIRST, 32 * FIRST, PROBE, PROBE]
    assert probes(sensor, 0.002, 8) == pytest.approx(wanted, abs=0.0003)


def test_a_parked_sensor_is_asked_exactly_when_its_pause_is_over() -> None:
    sensor = Sensor(200, FIELDS)
    sensor.spoil(0.0)
    assert sensor.ask(FIRST - 1e-9) is None
    assert sensor.ask(FIRST) == WHOLE


def test_a_reply_that_spoilt_a_reading_has_come_and_no_other_is_expected() -> None:
    sensor = Sensor(200, FIELDS)
    miss(sensor, 1.0)
    sensor.spoil(1.5)
    assert not sensor.owes(1.5)
    assert answer(sensor, 1.6) == WHOLE
    assert not sensor.calm(2.4, 1.0)
    assert sensor.calm(2.6, 1.0)


@pytest.mark.parametrize(("well", "pause"), [(7.0, 7.68), (7.7, FIRST)])
def test_pauses_begin_anew_once_it_was_well_for_longer_than_the_last(well: float, pause: float) -> None:
    sensor = Sensor(200, FIELDS)
    sensor.spoil(0.0)
    now = sum(probes(sensor, 0.0, 6)) + well
    answer(sensor, now)
    sensor.spoil(now)
    assert probes(sensor, now, 1) == pytest.approx([pause], abs=0.0003)


@pytest.mark.parametrize(("well", "pause"), [(1.0, 4 * FIRST), (1.001, FIRST)])
def test_and_for_longer_than_a_second(well: float, pause: float) -> None:
    sensor = Sensor(200, FIELDS)
    sensor.spoil(0.0)
    answer(sensor, 0.1)
    answer(sensor, well)
    sensor.spoil(well)
    assert probes(sensor, well, 1) == pytest.approx([pause], abs=0.0003)


def test_a_sensor_that_was_well_for_long_is_probed_each_second_again() -> None:
    sensor = Sensor(200, FIELDS)
    sensor.spoil(0.0)
    answer(sensor, 0.1)
    answer(sensor, 9.0)
    for tick in range(MISSES):
        miss(sensor, 9.0 + 0.001 * tick)
    assert probes(sensor, 9.002, 8)[-2:] == pytest.approx([PROBE, PROBE], abs=0.0003)


def test_calm_is_a_sensor_without_a_fault_for_so_long() -> None:
    sensor = Sensor(200, FIELDS)
    assert sensor.calm(0.0, 100.0)
    miss(sensor, 1.0)
    assert not sensor.calm(2.999, 2.0)
    assert sensor.calm(3.0, 2.0)
    sensor.spoil(3.0)
    assert not sensor.calm(100.0, 2.0), "it is parked"


def test_a_port_that_was_closed_begins_anew() -> None:
    sensor = Sensor(200, FIELDS)
    miss(sensor, 0.0)
    sensor.ask(0.01)
    sensor.forget()
    assert not sensor.owes(0.02)
    assert sensor.take(SOUND, 0.02) is None, "nothing was asked since"
    assert answer(sensor, 0.03) == WHOLE
    miss(sensor, 0.04)
    miss(sensor, 0.05)
    sensor.forget()
    for now in (0.06, 0.061, 0.062):
        assert not sensor.parked, "two misses were those of another port"
        miss(sensor, now)
    assert sensor.parked
    sensor.spoil(0.07)
    sensor.forget()
    assert not sensor.parked
    assert sensor.ask(0.08) == WHOLE


def test_one_reply_is_taken_once() -> None:
    sensor = Sensor(200, FIELDS)
    sensor.ask(0.0)
    assert sensor.take(SOUND, 0.001) is not None
    assert sensor.take(SOUND, 0.002) is None
