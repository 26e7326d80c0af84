"""Lease of remote clients: one holder, a second without a renewal; a lapsed lease does not come back."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.uplink.remote_lease import RemoteLease
from twind.bridge.zenoh.zenoh_keys import LEASE_S
from twind.client import CallError, Refused
from twind.safety.lease import TRAJECTORY


def error_of(call: Callable[[], object]) -> CallError | None:
    try:
        call()
    except CallError as error:
        return error
    return None


steps = st.lists(
    st.tuples(st.sampled_from(["acquire", "take", "renew", "end", "wait"]), st.floats(0.0, 2.0 * LEASE_S)),
    max_size=30,
)


def test_a_lease_from_afar_lasts_as_long_as_the_daemons() -> None:
    assert LEASE_S == TRAJECTORY


@given(steps)
def test_at_most_one_token_commands_and_only_until_a_second_after_its_last_renewal(
    script: list[tuple[str, float]],
) -> None:
    tenancy = RemoteLease()
    now = 100.0
    tokens = list[str]()
    renewed = dict[str, float]()
    for what, seconds in script:
        now += seconds
        if what in ("acquire", "take"):
            refusal = error_of(lambda: tenancy.admits(now, take=what == "take"))  # noqa: B023
            assert refusal is None or (what == "acquire" and refusal.name == "LeaseHeld")
            if refusal is not None:
                continue
            granted = tenancy.grant("somebody", now)
            assert granted["lease"] not in tokens and granted["now"] == now
            tokens.append(granted["lease"])
            renewed[tokens[-1]] = now
        elif what == "renew" and tokens:
            refusal = error_of(lambda: tenancy.renew(tokens[-1], now))  # noqa: B023
            if refusal is None:
                renewed[tokens[-1]] = now
            else:
                assert refusal.parameters["findings"][0]["code"] == "LEASE_MISSING"
        elif what == "end":
            tenancy.end()
            renewed.clear()
        holding = [token for token in tokens if tenancy.holds(token, now)]
        assert holding in ([], tokens[-1:])
        assert bool(holding) == tenancy.is_held(now)
        assert not holding or now - renewed[holding[0]] <= LEASE_S
        assert not tenancy.holds("", now)


def test_renewals_that_were_held_up_on_the_way_renew_nothing() -> None:
    tenancy = RemoteLease()
    lease = tenancy.grant("desk", 10.0)["lease"]
    for late in (11.5, 11.6, 10.2):  # a link that was stuck empties its queue
        with pytest.raises(Refused):
            tenancy.renew(lease, late)
    assert not tenancy.holds(lease, 10.3), "a lease that has been seen lapsed does not come back"


def test_a_replaced_lease_commands_nothing_and_cannot_be_renewed() -> None:
    tenancy = RemoteLease()
    first = tenancy.grant("first", 10.0)["lease"]
    second = tenancy.grant("second", 10.1)
    assert not tenancy.holds(first, 10.1) and tenancy.holds(second["lease"], 10.1)
    assert second["holder"] == "second" and second["expires_in"] == LEASE_S
    with pytest.raises(Refused):
        tenancy.renew(first, 10.1)
