"""Messages survive the way there and back, and what cannot be right is refused."""

import math
import types
from collections.abc import Sequence
from enum import Enum
from typing import Any, Union, get_args, get_origin

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind import link
from twind.robot.finding import Finding, ReasonCode
from twind.robot.trajectory import Trajectory

INWARD = get_args(link.Inward)
OUTWARD = get_args(link.Outward)
PLAIN = st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats() | st.text()


def values(kind: Any) -> st.SearchStrategy[Any]:
    """Any value that a field of this type may have."""
    simple: dict[Any, st.SearchStrategy[Any]] = {
        int: st.integers(-(2**63), 2**63 - 1),
        float: st.floats(),
        str: st.text(),
        bool: st.booleans(),
        bytes: st.binary(),
        type(None): st.none(),
        Any: PLAIN,
    }
    if kind in simple:
        return simple[kind]
    inside = get_args(kind)
    if get_origin(kind) in (Union, types.UnionType):
        return st.one_of([values(one) for one in inside])
    if get_origin(kind) is Sequence:
        return st.lists(values(inside[0]), max_size=3)
    if get_origin(kind) is tuple:
        return st.tuples(*[values(one) for one in inside])
    if get_origin(kind) is dict:
        return st.dictionaries(st.text(), values(inside[1]), max_size=3)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return st.sampled_from(list(kind))
    if kind is Finding:
        return st.builds(
            Finding,
            code=st.sampled_from(list(ReasonCode)),
            joint=st.none() | st.integers(0, 99),
            value=st.none() | st.floats(),
            message=st.text(),
        )
    return st.builds(kind, **{field.name: values(field.type) for field in msgspec.structs.fields(kind)})


# ------------------------------------------------------------------------------------- messages


@pytest.mark.parametrize("kind", INWARD)
def test_every_command_arrives_as_it_was_sent(kind: type[Any]) -> None:
    @examples(8)
    @given(values(kind))
    def there_and_back(command: Any) -> None:
        data = link.encode(command)
        arrived = link.decode_command(data)
        assert type(arrived) is kind
        assert link.encode(arrived) == data

    there_and_back()


@pytest.mark.parametrize("kind", OUTWARD)
def test_all_news_arrive_as_they_were_sent(kind: type[Any]) -> None:
    @examples(8)
    @given(values(kind))
    def there_and_back(news: Any) -> None:
        data = link.encode(news)
        arrived = link.decode_news(data)
        assert type(arrived) is kind
        assert link.encode(arrived) == data

    there_and_back()


def test_numbers_that_are_none_arrive_as_they_are() -> None:
    command = link.Setpoint(ticket=1, client=2, joints=[0, 1], positions=[math.nan, math.inf])
    arrived = link.decode_command(link.encode(command))
    assert isinstance(arrived, link.Setpoint)
    assert math.isnan(arrived.positions[0])
    assert math.isinf(arrived.positions[1])


def test_every_call_can_be_answered_and_belongs_to_a_connection() -> None:
    for kind in INWARD:
        if issubclass(kind, link.Command):
            with pytest.raises(TypeError, match="ticket"):
                kind(client=1)
            with pytest.raises(TypeError, match="client"):
                kind(ticket=1)


def packed(**fields: Any) -> bytes:
    return msgspec.msgpack.encode(fields)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        packed(ticket=1, client=1),
        packed(kind="Fly", ticket=1, client=1),
        packed(kind="Cancel", client=1),
        packed(kind="Cancel", ticket="1", client=1),
        packed(kind="Cancel", ticket=1, client=1)[:-1],
        packed(kind="Setpoint", ticket=1, client=1, joints=[0], positions=["0.1"]),
        packed(kind="Tick", ticket=1, client=1),  # news of the loop are no command
        link.encode(link.Reply(ticket=1)),
    ],
)
def test_an_invalid_command_is_refused(data: bytes) -> None:
    with pytest.raises(msgspec.MsgspecError):
        link.decode_command(data)


def test_a_command_is_no_news() -> None:
    with pytest.raises(msgspec.MsgspecError):
        link.decode_news(link.encode(link.Heartbeat()))


# ------------------------------------------------------------------------------------- trajectories


@st.composite
def paths(draw: st.DrawFn) -> Trajectory:
    """Any numbers in any shape, the wrong ones too: the gate judges, the link only carries."""
    k = draw(st.integers(1, 5))
    n = draw(st.integers(1, 4))
    rich = draw(st.integers(0, 2))
    numbers = draw(st.lists(st.floats(width=64), min_size=k * (1 + 3 * n), max_size=k * (1 + 3 * n)))
    rows = np.array(numbers[k:]).reshape(3, k, n)
    commanded = np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    given = [rows[1] if rich > 0 else None, rows[2] if rich > 1 else None]
    return Trajectory(np.array(numbers[:k]), rows[0], commanded, *given)


def submit(path: Trajectory, **changes: Any) -> link.Submit:
    fields: dict[str, Any] = {
        "points": len(path.time),
        "commanded": np.flatnonzero(path.commanded).tolist(),
        "velocity": path.velocity is not None,
        "acceleration": path.acceleration is not None,
    }
    return link.Submit(ticket=1, client=1, id="t", **(fields | changes))


def same(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    if one is None or other is None:
        return one is other
    return one.shape == other.shape and one.tobytes() == other.tobytes()


@examples(100)
@given(paths())
def test_a_trajectory_arrives_bit_by_bit_as_it_was_packed(path: Trajectory) -> None:
    arrived = link.unpack_path(link.pack_path(path), submit(path), len(path.commanded))
    assert same(arrived.time, path.time)
    assert same(arrived.position, path.position)
    assert same(arrived.velocity, path.velocity)
    assert same(arrived.acceleration, path.acceleration)
    assert arrived.commanded.tolist() == path.commanded.tolist()


def test_columns_in_any_memory_order_are_packed_by_rows() -> None:
    rows = np.asfortranarray(np.arange(6.0).reshape(3, 2))
    path = Trajectory(np.arange(3.0), rows, np.array([True, True]))
    assert link.unpack_path(link.pack_path(path), submit(path), 2).position.tolist() == rows.tolist()


@examples(60)
@given(paths(), st.integers(-100, 100).filter(bool))
def test_bytes_too_many_or_too_few_are_refused(path: Trajectory, difference: int) -> None:
    data = link.pack_path(path)
    wrong = data + bytes(difference) if difference > 0 else data[:difference]
    with pytest.raises(ValueError):
        link.unpack_path(wrong, submit(path), len(path.commanded))


@pytest.mark.parametrize(
    "changes",
    [
        {"points": 2},
        {"points": 4},
        {"points": 0},
        {"points": -3},
        {"velocity": True},
        {"velocity": True, "acceleration": True},
        {"commanded": [0, 2]},
        {"commanded": [-1]},
    ],
)
def test_a_command_that_does_not_fit_its_bytes_is_refused(changes: dict[str, Any]) -> None:
    path = Trajectory(np.arange(3.0), np.zeros((3, 2)), np.array([True, True]))
    with pytest.raises(ValueError):
        link.unpack_path(link.pack_path(path), submit(path, **changes), 2)


def test_accelerations_without_velocities_are_refused() -> None:
    path = Trajectory(np.arange(3.0), np.zeros((3, 2)), np.array([True, True]), None, np.zeros((3, 2)))
    with pytest.raises(ValueError, match="accelerations need velocities"):
        link.unpack_path(link.pack_path(path), submit(path), 2)


def test_no_bytes_at_all_are_refused() -> None:
    path = Trajectory(np.arange(3.0), np.zeros((3, 2)), np.array([True, True]))
    with pytest.raises(ValueError):
        link.unpack_path(b"", submit(path), 2)
    with pytest.raises(ValueError):
        link.unpack_path(b"", submit(path, points=0), 2)
