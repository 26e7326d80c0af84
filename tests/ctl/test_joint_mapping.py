"""Claims of `twind.ctl.following.joint_mapping`."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.ctl.following.joint_mapping import STALE, JointLink, link_joints, stale_reading
from twind.exceptions import InvalidInput

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)


def test_joints_of_one_name_and_renamed_ones_are_linked_in_the_order_of_the_follower() -> None:
    links = link_joints(["a", "b", "x"], ["y", "b", "z"], {"x": "y"}, {"y": -2.0}, {"y": 0.5})
    assert links == (JointLink("x", "y", -2.0, 0.5), JointLink("b", "b"))
    assert links[0].goal(1.0) == -1.5


def test_a_renamed_joint_takes_the_place_of_the_one_of_the_same_name() -> None:
    assert link_joints(["a", "b"], ["a"], {"b": "a"}, {}, {}) == (JointLink("b", "a"),)


@pytest.mark.parametrize(
    ("renamed", "scales", "offsets"),
    [
        ({"q": "a"}, {}, {}),
        ({"a": "q"}, {}, {}),
        ({"a": "b", "b": "b"}, {}, {}),
        ({}, {"q": 1.0}, {}),
        ({}, {"a": float("nan")}, {}),
        ({}, {}, {"a": float("inf")}),
    ],
)
def test_wrong_input_is_refused(
    renamed: dict[str, str], scales: dict[str, float], offsets: dict[str, float]
) -> None:
    with pytest.raises(InvalidInput):
        link_joints(["a", "b"], ["a", "b"], renamed, scales, offsets)


def test_robots_without_a_common_joint_are_refused() -> None:
    with pytest.raises(InvalidInput, match="--map"):
        link_joints(["a"], ["b"], {}, {}, {})


@given(NUMBERS, NUMBERS, NUMBERS)
def test_a_reading_is_used_only_if_it_is_fresh_and_finite(past: float, age: float, position: float) -> None:
    usable = stale_reading([JointLink("a", "b")], past, {"a": position}, {"a": age}) is None
    finite = abs(position) < float("inf")
    assert usable == (0.0 <= past <= STALE and past <= past + age <= STALE and finite)


def test_a_joint_that_is_missing_in_the_reading_is_stale() -> None:
    assert stale_reading([JointLink("a", "b")], 0.0, {}, {}) is not None
