"""`twindctl ros` as a verb: which back end, whose graph, and words for what is missing."""

import argparse
import os
import re
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from twind.bridge.ros import choice, ros_command
from twind.bridge.ros.discovery import DiscoveryRange, DiscoverySettings
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
    ("words", "said"),
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
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ros", "--backend", "dds", *words]) == 2
    assert said in capsys.readouterr().err


def test_a_variable_that_makes_no_sense_is_usage(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "EVERYWHERE")
    assert main(["ros", "--backend", "dds"]) == 2
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE='EVERYWHERE'" in capsys.readouterr().err


def test_an_unknown_middleware_is_a_usage_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "foo")
    monkeypatch.setattr(choice, "installed", lambda environment, distro: None)
    assert main(["ros"]) == 2
    assert "RMW_IMPLEMENTATION='foo': must be one of rmw_zenoh_cpp" in capsys.readouterr().err


@pytest.mark.parametrize("name", ros_command.BACK_ENDS)
def test_a_package_that_is_missing_is_named_with_its_remedy(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_command, "find_spec", lambda name: None)
    module = ros_command.BACK_ENDS[name][1][0]
    with pytest.raises(UsageError, match=rf"needs {module}.*{re.escape(how_to_add('ros'))}"):
        ros_command.made(options("--backend", name), DiscoverySettings())


@pytest.mark.parametrize("name", ros_command.BACK_ENDS)
def test_the_extra_of_this_environment_has_every_module_that_is_needed(name: str) -> None:
    pytest.importorskip(ros_command.BACK_ENDS[name][1][0], reason="no wheel for this machine")
    assert bool(ros_command.made(options("--backend", name), DiscoverySettings()).refuses) == (name == "dds")


@pytest.mark.parametrize(
    ("graph", "words", "said"),
    [
        (DiscoverySettings(), [], "domain 0: this machine; this machine may move the robot"),
        (DiscoverySettings(5), ["--no-commands"], "domain 5: this machine; read only: --no-commands"),
        (
            DiscoverySettings(0, DiscoveryRange.SUBNET, ("10.0.0.1",)),
            [],
            "this network (SUBNET, 10.0.0.1) may move the robot",
        ),
        (
            DiscoverySettings(0, DiscoveryRange.LOCALHOST, ("10.0.0.1",)),
            [],
            "this network (LOCALHOST, 10.0.0.1) may move",
        ),
    ],
)
def test_the_first_line_names_the_graph_and_its_permissions(
    graph: DiscoverySettings, words: list[str], said: str, tmp_path: Path
) -> None:
    given: Any = options("--backend", "rclpy", *words)
    given.socket = str(tmp_path)
    assert said in ros_command._headline(given, graph)


def test_the_first_line_over_dds_names_the_back_ends_that_accept_commands(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("cyclonedds", reason="no wheel for this machine")
    lines: list[str] = []
    monkeypatch.setattr(ros_command, "print_line", lines.append)
    monkeypatch.setattr("twind.bridge.ros.ros_bridge.RosBridge.run", lambda course: 0)
    given: Any = options("--backend", "dds")
    given.socket = str(tmp_path)
    assert ros_command._bridge(given, DiscoverySettings(5), threading.Event()) == 0
    assert lines[0].startswith(
        "ROS 2 by dds, domain 5: this machine; read only: DDS without ROS takes no commands"
    )
    assert "--backend rclpy" in lines[0] and "--backend zenoh" in lines[0] and "may move" not in lines[0]


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
