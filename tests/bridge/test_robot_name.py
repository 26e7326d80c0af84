"""What a robot is called on the network."""

from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.uplink.robot_name import robot_name
from twind.bridge.zenoh.zenoh_keys import robot_key, robot_of


@given(st.text(), st.one_of(st.none(), st.text()))
def test_every_name_is_one_chunk_of_a_key(robot: str, individual: str | None) -> None:
    name = robot_name({"robot": robot}, {"individual": individual})
    assert robot_of(robot_key(name, "alive")) == name


def test_the_individual_goes_before_the_kind() -> None:
    assert robot_name({"robot": "h24"}, {"individual": "h24-007"}) == "h24-007"
    assert robot_name({"robot": "h24"}, {}) == robot_name({"robot": "h24"}, {"individual": None}) == "h24"
    assert robot_name({"robot": "a robot/**"}, {}) == "a-robot---"
