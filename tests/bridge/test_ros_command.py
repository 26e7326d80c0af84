"""`twindctl ros` as a verb: back end, graph, and the report of what is missing."""

import argparse
import os
import re
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from twind.bridge.ros import ros_command
from twind.bridge.ros.discovery import DiscoverySettings
from twind.command_line.extras import how_to_add
from twind.command_line.verb import UsageError
from twind.ctl.ctl_main import main


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """No ROS is sourced."""
    for name in ("ROS_DISTRO", "AMENT_PREFIX_PATH", "RMW_IMPLEMENTATION", "ROS_DOMAIN_ID"):
        monkeypatch.delenv(name, raising=False)


def options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    ros_command.add_arguments(parser)
    return parser.parse_args(words)


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--domain", "233"], "domain 233: must be 0 to 232"),
        (["--distro", "../x"], "ROS_DISTRO"),
        (["--distro", "foo"], "distribution 'foo': must be one of humble"),
        (["--backend", "zenoh", "--zenoh-connect", "foo"], "--zenoh-connect foo: expected tcp/HOST:PORT"),
        (["--rate", "0"], "--rate 0: must be above 0 Hz"),
        (["--rate", "nan"], "--rate nan: must be above 0 Hz"),
    ],
)
def test_an_invalid_ros_option_is_a_usage_error(
    words: list[str], error: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ros", "--backend", "dds", *words]) == 2
    assert error in capsys.readouterr().err


@pytest.mark.parametrize("name", ros_command.BACK_ENDS)
def test_a_package_that_is_missing_is_named_with_its_remedy(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_command, "find_spec", lambda name: None)
    module = ros_command.BACK_ENDS[name][1][0]
    with pytest.raises(UsageError, match=rf"needs {module}.*{re.escape(how_to_add('ros'))}"):
        ros_command.made(options("--backend", name), DiscoverySettings(), print)


@pytest.mark.parametrize("name", ros_command.BACK_ENDS)
def test_the_extra_of_this_environment_has_every_module_that_is_needed(name: str) -> None:
    pytest.importorskip(ros_command.BACK_ENDS[name][1][0], reason="no wheel for this machine")
    assert bool(ros_command.made(options("--backend", name), DiscoverySettings(), print).refuses) == (
        name == "dds"
    )


@pytest.mark.parametrize(
    ("words", "reach", "peers", "headline"),
    [
        (["rclpy"], "", "", "domain 0: this machine; this machine may move the robot"),
        (["rclpy", "--no-commands"], "", "", "domain 0: this machine; read only: --no-commands"),
        (["rclpy"], "SUBNET", "10.0.0.1", "this network (SUBNET, 10.0.0.1) may move the robot"),
        (["rclpy"], "LOCALHOST", "10.0.0.1", "this network (LOCALHOST, 10.0.0.1) may move"),
        (["dds", "--domain", "5"], "", "", "ROS 2 by dds, domain 5: this machine; read only: DDS without"),
    ],
)
def test_the_first_line_names_the_graph_and_its_permissions(
    words: list[str],
    reach: str,
    peers: str,
    headline: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if words[0] == "dds":
        pytest.importorskip("cyclonedds", reason="no wheel for this machine")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", reach)
    monkeypatch.setenv("ROS_STATIC_PEERS", peers)
    monkeypatch.setattr("twind.bridge.ros.rclpy_launcher.launch", lambda options, tell: 0)
    monkeypatch.setattr("twind.bridge.ros.ros_bridge.RosBridge.run", lambda bridge: 0)
    assert main(["--socket", str(tmp_path), "ros", "--backend", *words]) == 0
    assert headline in capsys.readouterr().err


def test_a_reader_of_standard_error_that_is_gone_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with monkeypatch.context() as patched, os.fdopen(writing, "w", closefd=False) as gone:
        patched.setattr(sys, "stderr", gone)
        ros_command.print_line("one")
        ros_command.print_line("another")
        with suppress(BrokenPipeError):
            gone.close()
    os.close(writing)


@pytest.mark.parametrize("name", ros_command.BACK_ENDS)
def test_the_node_has_the_namespace_of_the_arguments_of_ros(name: str) -> None:
    pytest.importorskip({"dds": "cyclonedds"}.get(name, name))
    words = ("--backend", name, "--ros-args", "-r", "__ns:=/left")
    assert ros_command.made(options(*words), DiscoverySettings(), print).node == "/left/twind"
