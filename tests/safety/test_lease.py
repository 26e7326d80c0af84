from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.safety.lease import STREAMING, TRAJECTORY, Lease, LeaseHolder

A = 1
B = 2


def held(now: float = 10.0, client: int = A) -> Lease:
    lease = Lease()
    assert lease.acquire(client, f"uid {client}", client, now)
    return lease


def test_the_lease_times_are_one_second_and_a_quarter_of_a_second_for_setpoints() -> None:
    assert (TRAJECTORY, STREAMING) == (1.0, 0.25)  # docs/protocol.md: what clients count on


def test_a_new_lease_has_no_holder() -> None:
    lease = Lease()
    assert not lease.holds(0.0)
    assert (lease.holder_client(0.0), lease.info(0.0), lease.epoch) == (0, None, 0)
    assert not lease.held_by(0, 0.0)


def test_a_held_lease_is_refused_to_another_client() -> None:
    lease = held()
    assert lease.info(10.25) == LeaseHolder(A, "uid 1", 1, 0.75)
    assert lease.held_by(A, 10.0)
    assert not lease.acquire(B, "uid 2", 2, 10.5)
    assert (lease.holder_client(10.5), lease.epoch) == (A, 1)


def test_taking_it_again_renews_it_and_is_no_change_of_hands() -> None:
    lease = held()
    assert lease.acquire(A, "uid 1", 1, 10.9)
    assert lease.holds(11.8)
    assert lease.epoch == 1


def test_an_operator_may_take_it_from_another() -> None:
    lease = held()
    lease.pin(A, "motion")
    assert lease.acquire(B, "uid 2", 2, 10.1, take=True)
    assert (lease.holder_client(10.1), lease.held_by(A, 10.1), lease.epoch) == (B, False, 2)
    assert not lease.holds(10.1 + TRAJECTORY + 0.01)  # the pin of the other has gone with him


@pytest.mark.parametrize("client", [0, -1])
def test_a_client_that_is_none_never_holds_it(client: int) -> None:
    lease = Lease()
    assert not lease.acquire(client, "", -1, 0.0)
    assert not lease.acquire(client, "", -1, 0.0, take=True)
    assert not lease.release(client)
    lease.pin(client, "x")
    assert not lease.holds(0.0)


@pytest.mark.parametrize(("after", "still"), [(0.0, True), (TRAJECTORY, True), (TRAJECTORY + 1e-9, False)])
def test_a_lease_lasts_one_second(after: float, still: bool) -> None:
    assert held(0.0).holds(after) is still


@pytest.mark.parametrize(("after", "still"), [(STREAMING, True), (STREAMING + 1e-9, False)])
def test_a_lease_lasts_a_quarter_of_a_second_while_setpoints_are_streamed(after: float, still: bool) -> None:
    lease = held(0.0)
    assert lease.renew(A, 0.0, streaming=True)
    assert lease.holds(after) is still


def test_a_lease_acquired_again_after_setpoints_lasts_one_second() -> None:
    lease = held(0.0)
    assert lease.renew(A, 0.0, streaming=True)
    assert lease.acquire(A, "", A, 0.1)
    assert lease.holds(0.1 + TRAJECTORY)


@pytest.mark.parametrize("now", [nan, inf, -inf, 9.999])
def test_a_time_that_is_unknown_or_runs_back_is_too_late(now: float) -> None:
    lease = held(10.0)
    assert not lease.holds(now)
    assert not lease.holds(10.1)  # what lapsed does not come back


def test_only_the_holder_renews_and_only_in_time() -> None:
    lease = held()
    assert not lease.renew(B, 10.5)
    assert lease.renew(A, 11.0)
    assert lease.renew(A, 12.0)
    assert not lease.renew(A, 13.1)
    assert not lease.renew(A, 13.1)


def test_giving_it_back_frees_it() -> None:
    lease = held()
    assert not lease.release(B)
    assert lease.release(A)
    assert not lease.release(A)
    assert lease.acquire(B, "", 0, 10.0)
    assert lease.epoch == 3


def test_a_lease_ends_with_its_connection_and_with_the_front() -> None:
    lease = held()
    assert not lease.release_client(B)
    assert lease.release_client(A)
    assert not lease.holds(10.0)
    lease = held()
    lease.pin(A, "motion")
    lease.front_lost()
    assert not lease.holds(10.0)
    lease.front_lost()
    assert lease.epoch == 2


def test_a_followed_trajectory_keeps_it_and_its_end_begins_a_last_term() -> None:
    lease = held()
    lease.pin(B, "not the holder's")
    lease.pin(A, "first")
    lease.pin(A, "second")
    assert lease.holds(100.0)
    assert lease.info(100.0) == LeaseHolder(A, "uid 1", 1, TRAJECTORY)
    lease.unpin(A, "first")
    lease.unpin(A, "unknown")
    lease.unpin(B, "second")
    assert lease.renew(A, 150.0, streaming=True)
    assert lease.holds(200.0)
    lease.unpin(A, "second")
    assert lease.holds(200.0 + TRAJECTORY)
    assert not lease.holds(200.0 + TRAJECTORY + 0.01)


def test_a_lease_that_lapsed_cannot_be_pinned_back() -> None:
    lease = held()
    assert not lease.holds(12.0)
    lease.pin(A, "late")
    assert not lease.holds(12.0)


calls = st.one_of(
    st.tuples(st.just("acquire"), st.integers(0, 3), st.booleans()),
    st.tuples(st.just("renew"), st.integers(0, 3), st.booleans()),
    st.tuples(st.just("release"), st.integers(0, 3)),
    st.tuples(st.just("gone"), st.integers(0, 3)),
    st.tuples(st.just("pin"), st.integers(0, 3), st.sampled_from("ab")),
    st.tuples(st.just("unpin"), st.integers(0, 3), st.sampled_from("ab")),
    st.tuples(st.just("front lost")),
    st.tuples(st.just("time"), st.floats(-0.1, 1.5)),
)


@given(st.lists(calls, max_size=40))
def test_the_lease_has_at_most_one_holder_and_its_epoch_never_decreases(history: list[tuple]) -> None:
    lease = Lease()
    now = 5.0
    epoch = 0
    before = 0
    for call in history:
        match call:
            case ("acquire", client, take):
                got = lease.acquire(client, "", 0, now, take=take)
                assert not got or lease.held_by(client, now)
            case ("renew", client, streaming):
                assert not lease.renew(client, now, streaming=streaming) or lease.held_by(client, now)
            case ("release", client):
                lease.release(client)
            case ("gone", client):
                lease.release_client(client)
                assert not lease.held_by(client, now)
            case ("pin", client, name):
                lease.pin(client, name)
            case ("unpin", client, name):
                lease.unpin(client, name)
            case ("front lost",):
                lease.front_lost()
                assert not lease.holds(now)
            case ("time", passed):
                now += passed
        holders = [client for client in range(5) if lease.held_by(client, now)]
        assert len(holders) == int(lease.holds(now))
        assert [lease.holder_client(now)] == (holders or [0])
        assert (lease.info(now) is None) == (not holders)
        assert lease.epoch >= epoch
        if [before] != (holders or [0]):
            assert lease.epoch > epoch
        epoch = lease.epoch
        before = lease.holder_client(now)


def test_a_refusal_is_a_plain_no() -> None:
    lease = held()
    assert lease.acquire(B, "uid 2", 2, 10.5) is False
    assert lease.renew(B, 10.5) is False
    assert lease.release(B) is False
    assert lease.release_client(B) is False
    assert lease.held_by(B, 10.5) is False
