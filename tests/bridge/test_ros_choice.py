"""Choice of the back end where none is named: rclpy where one loads, with a reason where it does not."""

import pytest

from twind.bridge.ros import choice
from twind.bridge.ros.choice import usual, without_ros
from twind.bridge.ros.rclpy_launcher import RosDistribution
from twind.command_line.verb import UsageError

ZENOH = {"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}
FOUND = RosDistribution("/opt/ros/jazzy/bin/python3", {})


def told(monkeypatch: pytest.MonkeyPatch, found: RosDistribution | None, fault: str) -> list[str]:
    """Lines that `usual` reports, with this rclpy on the machine and this fault of it."""
    monkeypatch.setattr(choice, "installed", lambda environment, distro: found)
    monkeypatch.setattr(choice, "fault", lambda found: fault)
    return []


@pytest.mark.parametrize("environment", [{}, ZENOH, {"RMW_IMPLEMENTATION": "rmw_of_theirs"}])
def test_an_rclpy_that_loads_is_chosen_on_every_middleware_without_a_word(
    environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = told(monkeypatch, FOUND, "")
    assert (usual(environment, None, lines.append), lines) == ("rclpy", [])


@pytest.mark.parametrize(("environment", "chosen"), [({}, "dds"), (ZENOH, "zenoh")])
def test_without_any_rclpy_the_middleware_decides_without_a_word(
    environment: dict[str, str], chosen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = told(monkeypatch, None, "")
    assert (usual(environment, None, lines.append), lines) == (chosen, [])


@pytest.mark.parametrize(("environment", "chosen"), [({}, "dds"), (ZENOH, "zenoh")])
def test_an_rclpy_that_does_not_load_is_reported_with_its_reason_and_what_is_taken_instead(
    environment: dict[str, str], chosen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = told(monkeypatch, FOUND, "no libpython")
    assert usual(environment, None, lines.append) == chosen
    assert lines == [f"no libpython; falling back to --backend {chosen}"]


def test_an_rclpy_that_cannot_be_named_is_reported_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def several(environment: object, distro: object) -> None:
        raise UsageError("humble, jazzy: say which one")

    lines: list[str] = []
    monkeypatch.setattr(choice, "installed", several)
    assert usual({}, None, lines.append) == "dds"
    assert lines == ["humble, jazzy: say which one; falling back to --backend dds"]


@pytest.mark.parametrize("name", ["", *choice.MIDDLEWARES])
def test_a_middleware_on_dds_is_met_by_dds(name: str) -> None:
    assert without_ros({"RMW_IMPLEMENTATION": name}) == "dds"


def test_an_unknown_middleware_without_rclpy_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    told(monkeypatch, None, "")
    with pytest.raises(UsageError, match="RMW_IMPLEMENTATION='foo': must be one of rmw_zenoh_cpp"):
        usual({"RMW_IMPLEMENTATION": "foo"}, None, print)
