"""Key space of robots: no name reaches beyond its own chunk."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.zenoh.zenoh_keys import chunk, robot_key, robot_name, robot_of


@given(st.text())
def test_a_name_is_one_chunk_of_a_key_or_none_at_all(name: str) -> None:
    try:
        key = robot_key(name, "state", "10")
    except ValueError as error:
        assert repr(name[:80]) in str(error)  # noqa: PT017  either way it is whole
    else:
        assert key.split("/") == ["twind", name, "state", "10"] and robot_of(key) == name
        assert not set(name) & set("*/$?#@ ")


@pytest.mark.parametrize("name", ["", "*", "**", "a/b", "a$b", "x" * 65, ".hidden", "n\n", "ä"])
def test_a_name_that_matches_other_keys_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="must be 1 to 64"):
        chunk("goal", name)


@given(st.text(), st.one_of(st.none(), st.text()))
def test_every_robot_name_is_one_chunk_of_a_key(robot: str, individual: str | None) -> None:
    name = robot_name({"robot": robot}, {"individual": individual})
    assert robot_of(robot_key(name, "alive")) == name


def test_the_name_of_the_individual_precedes_that_of_the_robot_file() -> None:
    assert robot_name({"robot": "h24"}, {"individual": "h24-007"}) == "h24-007"
    assert robot_name({"robot": "h24"}, {}) == robot_name({"robot": "h24"}, {"individual": None}) == "h24"
    assert robot_name({"robot": "a robot/**"}, {}) == "a-robot---"


@pytest.mark.parametrize("name", ["all robots", "x" * 65, ".hidden", "a\u202eb", "a\x9b2J"])
def test_a_key_of_a_name_that_no_robot_may_have_is_nobodys(name: str) -> None:
    with pytest.raises(ValueError, match="must be 1 to 64"):
        robot_of(f"twind/{name}/alive")


@pytest.mark.parametrize("key", ["", "twind", "twind/a", "other/a/alive"])
def test_a_foreign_key_names_no_robot(key: str) -> None:
    with pytest.raises(ValueError, match="none of twind's"):
        robot_of(key)
