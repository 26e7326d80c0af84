"""Interpreter and environment of the rclpy back end."""

import argparse
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from tests.support import interpreters
from tests.support import rclpy_environment as ros_peer
from twind.bridge.ros import rclpy_launcher
from twind.bridge.ros.rclpy_launcher import PROFILES, command, distribution, graph, profile
from twind.command_line.verb import UsageError

OPTIONS = argparse.Namespace(
    socket=None, rate=None, domain=None, commands=True, tf=True, distro=None, ros_args=[]
)
PATH = {"PATH": "/usr/bin:/bin"}


def prefix(folder: Path, version: str = "3.10", *, interpreter: bool = True) -> Path:
    """Make a prefix with the packages of a distribution."""
    packages = folder / "lib" / f"python{version}" / "site-packages" / "rclpy"
    packages.mkdir(parents=True)
    (packages / "__init__.py").write_text("")
    if interpreter:
        (folder / "bin").mkdir()
        (folder / "bin" / f"python{version}").symlink_to(sys.executable)
    return folder


def installed(root: Path, name: str, version: str = "3.10") -> Path:
    """A distribution below `root` that has a set-up to source."""
    place = prefix(root / name, version)
    lines = [
        f"export AMENT_PREFIX_PATH={place}",
        f"export PYTHONPATH={place}/lib/python{version}/site-packages",
        f"export ROS_DISTRO={name}",
        "echo sourced",
    ]
    (place / "setup.bash").write_text("\n".join(lines))
    return place


def test_a_sourced_distribution_counts_and_names_its_python_with_or_without_python_path(
    tmp_path: Path,
) -> None:
    place = prefix(tmp_path)
    sourced = PATH | {"AMENT_PREFIX_PATH": str(place)}
    packages = f"/nothing:{place}/lib/python3.10/site-packages"
    for environment in (sourced, sourced | {"PYTHONPATH": packages}):
        assert distribution(environment, None).python == str(place / "bin" / "python3.10")


def test_the_only_distribution_is_sourced(tmp_path: Path) -> None:
    place = installed(tmp_path, "humble")
    found = distribution(PATH | {"KEPT": "yes"}, None, tmp_path)
    assert found.python == str(place / "bin" / "python3.10")
    assert found.environment["ROS_DISTRO"] == "humble"
    assert found.environment["KEPT"] == "yes"


def test_several_installed_distributions_require_a_choice(tmp_path: Path) -> None:
    for name, version in (("humble", "3.10"), ("jazzy", "3.12")):
        installed(tmp_path, name, version)
    with pytest.raises(UsageError, match=r"humble, jazzy: choose one with --distro"):
        distribution(PATH, None, tmp_path)
    assert distribution(PATH, "jazzy", tmp_path).python.endswith("python3.12")
    assert distribution(PATH | {"ROS_DISTRO": "humble"}, None, tmp_path).python.endswith("python3.10")
    with pytest.raises(UsageError, match=r"no ROS 2 'iron'.*humble, jazzy"):
        distribution(PATH, "iron", tmp_path)


def test_a_distribution_that_is_named_comes_before_the_one_that_is_sourced(tmp_path: Path) -> None:
    place = installed(tmp_path, "jazzy", "3.12")
    other = installed(tmp_path, "humble")
    sourced = PATH | {"AMENT_PREFIX_PATH": str(other), "ROS_DISTRO": "humble"}
    assert distribution(sourced, "humble", tmp_path).python == str(other / "bin" / "python3.10")
    assert distribution(sourced, "jazzy", tmp_path).python == str(place / "bin" / "python3.12")


def test_a_missing_distribution_is_reported_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rclpy_launcher.sys, "prefix", str(tmp_path / "nothing built"))
    with pytest.raises(UsageError, match="--backend zenoh, which needs none, or dds, which only publishes"):
        distribution(PATH, None, tmp_path)
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare" / "setup.bash").write_text("")
    with pytest.raises(UsageError, match="no rclpy is on its paths"):
        distribution(PATH, None, tmp_path)
    (tmp_path / "bare" / "setup.bash").write_text("exit 3")
    with pytest.raises(UsageError, match=r"source .*bare/setup\.bash. failed"):
        distribution(PATH, None, tmp_path)
    place = prefix(tmp_path / "other", "3.99", interpreter=False)
    with pytest.raises(UsageError, match=r"python3\.99, which is not on the PATH"):
        distribution(PATH | {"AMENT_PREFIX_PATH": str(place)}, None)


def built(folder: Path) -> Path:
    """An interpreter where `make ros` has it, below `folder`."""
    place = folder / "ros" / "bin" / "python"
    place.parent.mkdir(parents=True)
    place.symlink_to(sys.executable)
    return place


def test_a_distribution_from_make_ros_is_found_last_and_only_for_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rclpy_launcher.sys, "prefix", str(tmp_path))
    nowhere = tmp_path / "nowhere"
    assert rclpy_launcher.installed(PATH, None, nowhere) is None
    python = built(tmp_path)
    assert distribution(PATH, None, nowhere).python == str(python)
    assert distribution(PATH | {"ROS_DISTRO": "kilted"}, None, nowhere).python == str(python)
    assert rclpy_launcher.installed(PATH, "jazzy", nowhere) is None
    assert rclpy_launcher.installed(PATH | {"ROS_DISTRO": "jazzy"}, None, nowhere) is None
    place = installed(tmp_path / "opt", "kilted", "3.12")
    assert distribution(PATH, None, tmp_path / "opt").python == str(place / "bin" / "python3.12")


def test_an_rclpy_that_loads_has_no_fault_and_one_that_does_not_has_a_reason(tmp_path: Path) -> None:
    python = interpreters.python("3.12")
    stand_in = Path(__file__).parents[1] / "support/ros_stand_in"
    loads = rclpy_launcher.RosDistribution(python, PATH | {"PYTHONPATH": str(stand_in)})
    assert rclpy_launcher.fault(loads) == ""
    assert "rclpy does not load under" in rclpy_launcher.fault(rclpy_launcher.RosDistribution(python, PATH))
    ends = "import os, sys; print('a library is old', file=sys.stderr, flush=True); os._exit(102)"
    for package in ("rclpy", "rcl_interfaces"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text(ends)
    broken = rclpy_launcher.RosDistribution(python, PATH | {"PYTHONPATH": str(tmp_path)})
    assert rclpy_launcher.fault(broken) == f"rclpy of {python} is not used: a library is old"
    missing = rclpy_launcher.RosDistribution(str(tmp_path / "python"), PATH)
    assert "No such file" in rclpy_launcher.fault(missing)


def test_the_check_starts_no_bridge_and_names_a_message_package_that_is_missing(tmp_path: Path) -> None:
    python = interpreters.python("3.12")
    for each in (Path(__file__).parents[1] / "support/ros_stand_in").iterdir():
        if each.name != "diagnostic_msgs":
            (tmp_path / each.name).symlink_to(each)
    found = rclpy_launcher.RosDistribution(python, PATH | {"PYTHONPATH": str(tmp_path)})
    assert "no diagnostic_msgs/msg/DiagnosticArray" in rclpy_launcher.fault(found)


def test_our_own_environment_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ours = tmp_path / "ours"
    theirs = tmp_path / "theirs"
    for each in (ours, theirs):
        (each / "bin").mkdir(parents=True)
        (each / "bin" / "python3.10").symlink_to(sys.executable)
    place = prefix(tmp_path / "ros", interpreter=False)
    monkeypatch.setattr(rclpy_launcher.sys, "prefix", str(ours))
    sourced = {"PATH": f"{ours}/bin:{theirs}/bin", "AMENT_PREFIX_PATH": str(place)}
    assert distribution(sourced, None).python == str(theirs / "bin" / "python3.10")


def test_unset_means_this_machine_alone() -> None:
    assert graph({}, None) == {"ROS_DOMAIN_ID": "0", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    assert graph({"ROS_DISTRO": "humble"}, 7)["ROS_LOCALHOST_ONLY"] == "1"
    asked = {"ROS_DOMAIN_ID": "3", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    assert graph(asked, None) == asked


@pytest.mark.parametrize("reach", ["OFF", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT"])
@pytest.mark.parametrize("peers", ["", "10.0.0.7"])
def test_rclpy_gets_the_discovery_settings_of_the_environment_and_not_its_defaults(
    reach: str, peers: str
) -> None:
    said = {"ROS_AUTOMATIC_DISCOVERY_RANGE": reach, "ROS_STATIC_PEERS": peers}
    told = graph({"ROS_DISTRO": "jazzy", **said}, None)
    assert told["ROS_AUTOMATIC_DISCOVERY_RANGE"] == reach
    assert told.get("ROS_STATIC_PEERS", "") == peers
    assert graph({"ROS_STATIC_PEERS": "10.0.0.7"}, None)["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    alone = graph({**said, "ROS_LOCALHOST_ONLY": "1"}, None)
    assert alone["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST" and "ROS_STATIC_PEERS" not in alone


@pytest.mark.parametrize(
    ("reach", "peers", "only"),
    [
        ("", "", "1"),
        ("LOCALHOST", "", "1"),
        ("SUBNET", "", "0"),
        ("SYSTEM_DEFAULT", "", "0"),
        ("OFF", "", None),
        ("LOCALHOST", "10.0.0.7", None),
        ("SUBNET", "10.0.0.7", None),
    ],
)
def test_humble_gets_only_the_localhost_variable_or_is_refused(
    reach: str, peers: str, only: str | None
) -> None:
    said = {"ROS_AUTOMATIC_DISCOVERY_RANGE": reach, "ROS_STATIC_PEERS": peers, "ROS_DISTRO": "humble"}
    if only is None:
        with pytest.raises(UsageError, match=r"humble has none; unset it, or take --backend dds"):
            graph(said, None)
    else:
        assert graph(said, None)["ROS_LOCALHOST_ONLY"] == only


def test_readers_of_fast_dds_request_a_lost_message_at_once_unless_the_user_has_a_profile() -> None:
    for distro, tag in (("humble", "initialAcknackDelay"), ("jazzy", "initialAcknackDelay")):
        (file,) = profile({"ROS_DISTRO": distro}).values()
        assert f"<{tag}><sec>0</sec><nanosec>1000000<" in Path(file).read_text()
    for name in PROFILES.values():
        assert profile({name: "own.xml"}) == {}


def test_the_real_fast_dds_accepts_its_profile_and_no_other(tmp_path: Path) -> None:
    program = "import rclpy; rclpy.init(); rclpy.create_node('mine')"
    for distro, accepted in (("kilted", True), ("jazzy", False)):
        environment = ros_peer.environment(tmp_path, 0)
        (file,) = profile({"ROS_DISTRO": distro}).values()
        environment |= {PROFILES[3]: file, "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
        words = [ros_peer.python(), "-c", program]
        done = subprocess.run(words, env=environment, capture_output=True, text=True)
        assert done.returncode == 0 and ("XMLPARSER" not in done.stdout + done.stderr) == accepted, done


def test_options_are_handed_on() -> None:
    words = command("/python3.10", OPTIONS)
    assert words[:2] == ["/python3.10", "-c"]
    assert words[4:] == ["--describer", sys.executable]
    options = argparse.Namespace(
        socket="/run/twind",
        rate=50.0,
        domain=7,
        commands=False,
        tf=False,
        distro=None,
        ros_args=["-r", "a:=b"],
    )
    words = command("/python3.10", options)[4:]
    assert words == [
        "--socket",
        "/run/twind",
        "--rate",
        "50.0",
        "--domain",
        "7",
        "--no-commands",
        "--ros-args",
        "-r",
        "a:=b",
    ]


def test_an_interpreter_without_rclpy_is_reported_in_one_line(tmp_path: Path) -> None:
    words = command(interpreters.python("3.10"), OPTIONS)
    done = subprocess.run(words, cwd=tmp_path, env=PATH, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "rclpy does not load under" in done.stderr
    assert "rcl" in done.stderr.splitlines()[0]
    assert len(done.stderr.splitlines()) == 1


def test_the_rclpy_process_imports_only_twind_from_this_installation(tmp_path: Path) -> None:
    """It imports neither our packages nor another `twind` in its working folder."""
    (tmp_path / "twind").mkdir()
    (tmp_path / "twind" / "__init__.py").write_text("raise SystemExit('the wrong twind')")
    words = command(interpreters.python("3.12"), OPTIONS)
    begin = words[2].partition("try:")[0] + "\nimport twind; print(twind.__file__, *sys.path, sep='\\n')"
    done = subprocess.run([words[0], "-c", begin, words[3]], cwd=tmp_path, capture_output=True, text=True)
    package, *path = done.stdout.splitlines()
    assert package == str(Path(rclpy_launcher.__file__).parents[2] / "__init__.py")
    assert sysconfig.get_path("purelib") not in path
    assert not {"", str(tmp_path)} & set(path)
