"""Outcomes of answers, delays before a retry, and the rate of its reports."""

import random
from email.utils import formatdate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.client.monitor_stream import RepeatedFaultFilter
from twind.learn.streaming.delivery_outcome import (
    FIRST,
    LONGEST,
    PATIENT,
    DeliveryBackoff,
    DeliveryOutcome,
    fate,
    retry_after,
)

RETRIED = (301, 302, 307, 308, 401, 403, 404, 405, 408, 409, 425, 429, 500, 501, 502, 503, 504, 599, 0, 100)


@pytest.mark.parametrize(
    ("outcome", "statuses"),
    [
        (DeliveryOutcome.DONE, (200, 201, 202, 204, 299)),
        (DeliveryOutcome.DEAD, (400, 406, 410, 411, 412, 413, 414, 415, 422, 431, 499)),
        (DeliveryOutcome.AGAIN, (*RETRIED, 999)),
    ],
)
def test_a_status_decides_the_outcome_of_a_message(
    outcome: DeliveryOutcome, statuses: tuple[int, ...]
) -> None:
    assert {status: fate(status) for status in statuses} == dict.fromkeys(statuses, outcome)


def test_retry_after_is_seconds_or_a_date_and_never_for_ever() -> None:
    wall = 1_800_000_000.0
    assert retry_after("7", wall) == 7.0
    assert retry_after(" 0 ", wall) == 0.0
    assert retry_after("999999999999999999999", wall) == PATIENT
    assert retry_after(formatdate(wall + 30.0, usegmt=True), wall) == pytest.approx(30.0, abs=1.0)
    assert retry_after(formatdate(wall - 30.0, usegmt=True), wall) == 0.0
    assert retry_after(formatdate(wall + 1e7, usegmt=True), wall) == PATIENT


@pytest.mark.parametrize("header", [None, "", "soon", "-1", "1.5", "²", "Mon, 99 Foo 2026", "0x10", "\x00"])
def test_an_invalid_retry_after_header_gives_no_delay(header: str | None) -> None:
    assert retry_after(header, 1e9) == 0.0


@given(st.text(max_size=40))
def test_no_header_is_waited_for_too_long(header: str) -> None:
    assert 0.0 <= retry_after(header, 1e9) <= PATIENT


def test_each_failure_in_a_row_waits_twice_as_long_to_a_bound_and_no_two_streamers_agree() -> None:
    one = DeliveryBackoff(random.Random(1))
    other = DeliveryBackoff(random.Random(2))
    for place in range(40):
        wait = min(LONGEST, FIRST * 2.0**place)
        for each in (one, other):
            each.failed(100.0)
            assert 100.0 + wait / 2.0 <= each.until <= 100.0 + wait
        assert one.until != other.until
    one.failed(100.0, asked=300.0)
    assert one.until == 400.0
    one.went_well()
    one.failed(200.0)
    assert one.until <= 200.0 + FIRST


def test_a_failure_is_reported_once_and_its_end_once() -> None:
    once = RepeatedFaultFilter(every=10.0)
    said = []
    for now, wrong in (
        (0.0, ""),
        (1.0, "refused"),
        (2.0, "refused"),
        (3.0, "reset"),
        (4.0, "refused"),
        (5.0, ""),
    ):
        if once.is_transition(wrong, now):
            said.append((now, wrong))
    assert said == [(1.0, "refused"), (5.0, "")]


def test_reasons_that_come_by_turns_get_a_line_now_and_then() -> None:
    once = RepeatedFaultFilter(every=10.0)
    assert sum(once.is_transition("ab"[int(now) % 2], now) for now in range(100)) <= 11
