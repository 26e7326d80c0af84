"""Overlong trajectories are recognised before strict JSON, and answered as the full path answers them."""

import json
import time
from typing import Any

import pytest

from twind.front.overlong_trajectory import MOST, overlong
from twind.protocol import CONTROL
from twind.protocol.strict_json import loads


def text(points: int, method: str = "Check", joints: int = 2, **call: Any) -> bytes:
    point = {"positions": [0.25] * joints, "time_from_start": 0.5}
    path = {"joint_names": [f"j{i}" for i in range(joints)], "points": [point] * points}
    whole = {"method": f"{CONTROL}.{method}", "parameters": {"trajectory": path}, **call}
    return json.dumps(whole).encode()


@pytest.mark.parametrize("method", ["Check", "SubmitTrajectory"])
def test_the_bound_is_exact_and_flags_are_kept(method: str) -> None:
    assert overlong(text(MOST, method)) is None
    found = overlong(text(MOST + 1, method, more=True))
    assert found is not None
    message, path = found
    assert (message["method"], message["more"], path.points) == (f"{CONTROL}.{method}", True, MOST + 1)
    assert path.joint_names == ["j0", "j1"]


@pytest.mark.parametrize(
    "data",
    [
        text(MOST + 1)[:-1],
        text(MOST + 1, "Mark"),
        text(MOST + 1).replace(b"joint_names", b"joints"),
        text(MOST + 1).replace(b'"time_from_start": 0.5}', b'"time_from_start": }', 1),
        text(2).replace(b"j0", b'\\"time_from_start\\"' * (MOST + 1)),
        json.dumps({"method": f"{CONTROL}.Check", "parameters": ["time_from_start"] * (MOST + 1)}).encode(),
    ],
    ids=["cut off", "another method", "no names", "no JSON", "in a string", "no points"],
)
def test_a_message_that_is_not_certainly_overlong_is_left_to_the_strict_parser(data: bytes) -> None:
    assert overlong(data) is None


def test_an_overlong_message_costs_a_fraction_of_its_parsing() -> None:
    data = text(3 * MOST, joints=24)
    loads(data)
    begun = time.process_time()
    loads(data)
    parsed = time.process_time() - begun
    begun = time.process_time()
    assert overlong(data) is not None
    assert time.process_time() - begun < parsed / 4
