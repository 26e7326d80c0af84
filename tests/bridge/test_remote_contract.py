"""Remote queries over Zenoh: invalid ones are refused with the reason, whatever the bytes are."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.commands.leased_motions import refusal
from twind.bridge.uplink import remote_contract
from twind.bridge.uplink.remote_contract import HOLDER, MOST, SMALL, check_query
from twind.bridge.zenoh.zenoh_keys import ASKED, STOPS
from twind.client import CallError

METHODS = (*ASKED, *STOPS, "Check", "Lease", "Goal")
GOAL = {"goal": "g", "lease": "l", "deadline": 1.5, "trajectory": {"joint_names": [], "points": []}}


@given(st.sampled_from(METHODS), st.binary(max_size=200))
def test_bytes_that_are_no_question_are_refused_and_break_nothing(method: str, data: bytes) -> None:
    try:
        said = check_query(method, data)
    except CallError as error:
        said = {"name": error.name, **error.parameters}
    assert isinstance(said, dict)
    assert said.get("name", "InvalidParameter") == "InvalidParameter"


def test_nothing_at_all_asks_what_needs_no_parameters() -> None:
    assert check_query("GetStatus", b"") == check_query("Cancel", b"{}") == {}


@pytest.mark.parametrize(
    ("method", "asked", "where"),
    [
        ("Lease", {}, "op"),
        ("Lease", {"op": "steal"}, "op"),
        ("Lease", {"op": ["renew"]}, "op"),
        ("Lease", {"op": "acquire", "take": 1}, "take"),
        ("Goal", {**GOAL, "deadline": "soon"}, "deadline"),
        ("Goal", {**GOAL, "lease": None}, "lease"),
        ("Goal", {**GOAL, "trajectory": []}, "trajectory"),
        ("Goal", {key: value for key, value in GOAL.items() if key != "goal"}, "goal"),
        ("GetStatus", {"method": "Arm"}, "method"),
        ("EStop", {"level": 3}, "level"),
        ("EStop", {"level": "nonsense"}, "level"),
    ],
)
def test_a_wrong_parameter_is_named(method: str, asked: dict[str, object], where: str) -> None:
    with pytest.raises(CallError) as told:
        check_query(method, json.dumps(asked).encode())
    assert told.value.parameters["parameter"] == where


@pytest.mark.parametrize(
    "data", [b'{"op":"renew","op":"acquire"}', b'{"deadline":NaN}', b"[" * 40 + b"]" * 40, b'"op"', b"\xff"]
)
def test_an_ambiguous_query_is_refused(data: bytes) -> None:
    with pytest.raises(CallError, match="parameter"):
        check_query("Lease", data)


def test_only_what_carries_a_trajectory_may_be_large() -> None:
    for method, most in (("Lease", SMALL), ("GetStatus", SMALL), ("Goal", MOST), ("Check", MOST)):
        with pytest.raises(CallError, match=f"{most + 1} bytes, bound {most}"):
            check_query(method, b" " * (most + 1))


def test_a_holder_name_is_cut_before_it_is_kept_or_published() -> None:
    said = json.dumps({"op": "acquire", "holder": "h" * 60_000}).encode()
    assert check_query("Lease", said)["holder"] == "h" * HOLDER


def test_a_finding_of_ours_has_the_fields_of_the_daemons() -> None:
    said = refusal("CMD_EXPIRED", "late", value=0.5, bound=0.0).parameters["findings"][0]
    remote_contract.load(remote_contract.CONTROL).types["Finding"].check(said, "finding")
