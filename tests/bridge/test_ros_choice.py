"""Choice of the back end where none is named: rclpy where one loads, with a reason where it does not."""

import pytest

from twind.bridge.ros import backend_choice
from twind.bridge.ros.backend_choice import usual, without_ros
from twind.bridge.ros.rclpy_launcher import RosDistribution
from twind.command_line.verb import UsageError

ZENOH = {"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}
FOUND = RosDistribution("/opt/ros/jazzy/bin/python3", {})


def install(monkeypatch: pytest.MonkeyPatch, found: RosDistribution | None, fault: str) -> None:
    """Put this rclpy with this fault on the machine."""
    monkeypatch.setattr(backend_choice, "installed", lambda environment, distro: found)
    monkeypatch.setattr(backend_choice, "fault", lambda found: fault)


@pytest.mark.parametrize(
    ("environment", "found", "fault", "chosen", "lines"),
    [
        ({}, FOUND, "", "rclpy", []),
        (ZENOH, FOUND, "", "rclpy", []),
        ({"RMW_IMPLEMENTATION": "rmw_of_theirs"}, FOUND, "", "rclpy", []),
        ({}, None, "", "dds", []),
        (ZENOH, None, "", "zenoh", []),
        ({}, FOUND, "no libpython", "dds", ["no libpython; falling back to --backend dds"]),
        (ZENOH, FOUND, "no libpython", "zenoh", ["no libpython; falling back to --backend zenoh"]),
    ],
)
def test_an_rclpy_that_loads_is_chosen_else_the_middleware_decides_and_a_fault_is_reported(
    environment: dict[str, str],
    found: RosDistribution | None,
    fault: str,
    chosen: str,
    lines: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    install(monkeypatch, found, fault)
    reported: list[str] = []
    assert (usual(environment, None, reported.append), reported) == (chosen, lines)


def test_an_rclpy_that_cannot_be_named_is_reported_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def several(environment: object, distro: object) -> None:
        raise UsageError("humble, jazzy: say which one")

    lines: list[str] = []
    monkeypatch.setattr(backend_choice, "installed", several)
    assert usual({}, None, lines.append) == "dds"
    assert lines == ["humble, jazzy: say which one; falling back to --backend dds"]


@pytest.mark.parametrize("name", ["", *backend_choice.MIDDLEWARES])
def test_a_middleware_on_dds_is_met_by_dds(name: str) -> None:
    assert without_ros({"RMW_IMPLEMENTATION": name}) == "dds"


def test_an_unknown_middleware_without_rclpy_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, None, "")
    with pytest.raises(UsageError, match="RMW_IMPLEMENTATION='foo': must be one of rmw_zenoh_cpp"):
        usual({"RMW_IMPLEMENTATION": "foo"}, None, print)
