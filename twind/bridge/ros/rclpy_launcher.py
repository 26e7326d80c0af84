"""Launcher of the rclpy back end: replaces this process by `rclpy_main` under the interpreter of rclpy.

rclpy is compiled for the Python of its distribution, and twind usually runs under another. So the process is
replaced by that interpreter, with the distribution's environment. Of this installation it sees only the
package `twind`, never its site-packages, whose numpy is for another Python. Standard library, 3.10.
"""

from __future__ import annotations

import argparse
import glob
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twind.bridge.ros.discovery import DiscoveryRange, discovery
from twind.bridge.ros.ros_names import ROS_ARGS
from twind.command_line.verb import UsageError

ROOT = Path("/opt/ros")  # where distributions are installed
BUILT = "kilted"  # the distribution of the wheels that `make ros` installs, as in constraints-ros.txt
SOURCED = 20.0  # s that the set-up of a distribution may take
LOADED = 60.0  # s that rclpy may take to load; about 1 s on an idle machine
OLD = ("foxy", "galactic", "humble")  # support only ROS_LOCALHOST_ONLY, which later ones warn of
FAST_DDS_2 = (*OLD, "iron", "jazzy")  # Fast DDS 2, whose profiles have other names of elements
PROFILES = {2: "FASTRTPS_DEFAULT_PROFILES_FILE", 3: "FASTDDS_DEFAULT_PROFILES_FILE"}  # by version
_PYTHON = re.compile(r"python3(?:\.\d+)?")

# What runs under the distribution's interpreter. It ends by `os._exit`: a usual end waits for callbacks that
# still wait for a daemon.
BEGIN = """
import importlib.util, os, sys
place = sys.argv.pop(1)
sys.path[:] = [each for each in sys.path if each]
spec = importlib.util.spec_from_file_location("twind", os.path.join(place, "__init__.py"),
                                              submodule_search_locations=[place])
sys.modules["twind"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(sys.modules["twind"])
try:
    from twind.bridge.ros import rclpy_main
except ImportError as error:
    print(f"twindctl: rclpy does not load under {sys.executable}: {error}", file=sys.stderr)
    os._exit(2)
code = rclpy_main.main(sys.argv[1:])
sys.stdout.flush()
sys.stderr.flush()
os._exit(code)
"""


@dataclass(frozen=True, slots=True)
class RosDistribution:
    """An installed rclpy: its interpreter, and the environment that it needs."""

    python: str
    environment: Mapping[str, str]


def launch(options: argparse.Namespace, tell: Callable[[str], None]) -> int:
    """Run `twindctl ros --backend rclpy`; does not return. Raises UsageError without rclpy, with the remedy.

    Of `options`: socket, rate, commands, tf, domain, distro, ros_args. The new process then handles
    signals.
    """
    found = distribution(os.environ, getattr(options, "distro", None))
    environment = graph(found.environment, options.domain) | profile(found.environment)
    words = command(found.python, options)
    tell(f"rclpy runs under {found.python}")
    sys.stdout.flush()
    sys.stderr.flush()
    os.execve(found.python, words, dict(environment))


def command(python: str, options: argparse.Namespace) -> list[str]:
    """Return the command line of the process that replaces this one."""
    words = begin(python)
    for name in ("socket", "rate", "domain"):
        value = getattr(options, name)
        words += [] if value is None else [f"--{name}", str(value)]
    words += ["--describer", sys.executable] if options.tf else []
    words += [] if options.commands else ["--no-commands"]
    return [*words, ROS_ARGS, *options.ros_args] if options.ros_args else words


def begin(python: str) -> list[str]:
    """Return the command that runs `rclpy_main` under the interpreter `python`."""
    return [python, "-c", BEGIN, str(Path(__file__).resolve().parents[2])]


def fault(found: RosDistribution) -> str:
    """Return why the back end does not load there, "" if it loads. Starts that interpreter once."""
    try:
        done = subprocess.run(
            [*begin(found.python), "--check"],
            env=dict(found.environment),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=LOADED,
        )
    except (OSError, subprocess.SubprocessError) as error:
        return f"rclpy of {found.python} is not used: {error}"
    if done.returncode == 0:
        return ""
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    reason = lines[-1].removeprefix("twindctl: ") if lines else f"exit code {done.returncode}"
    return f"rclpy of {found.python} is not used: {reason}"


def distribution(environment: Mapping[str, str], wanted: str | None, root: Path = ROOT) -> RosDistribution:
    """Return the result of `installed`. Raises UsageError: no rclpy, or several."""
    found = installed(environment, wanted, root)
    if found is None:
        remedy = "install one, or take --backend zenoh, which needs none, or dds, which only publishes"
        raise UsageError(f"rclpy: no ROS 2 in {root}, none sourced, none in this interpreter; {remedy}")
    return found


def installed(
    environment: Mapping[str, str], wanted: str | None, root: Path = ROOT
) -> RosDistribution | None:
    """The rclpy of the first of these that has one. None: no rclpy is installed.

    1. The environment, where ROS is sourced. 2. This interpreter. 3. The distributions in `root`: the
    `wanted` one, or the only one. 4. What `make ros` built.
    Raises UsageError: the interpreter of an rclpy is missing, no distribution of `root` is the wanted one,
    several are there and none is named, or a set-up fails.
    """
    other = wanted is not None and environment.get("ROS_DISTRO", wanted) != wanted
    sourced = None if other else _sourced(environment)
    if sourced is not None:
        return sourced
    if wanted is None and importlib.util.find_spec("rclpy") is not None:
        return RosDistribution(sys.executable, environment)
    name = wanted or environment.get("ROS_DISTRO")
    known = sorted(each.parent.name for each in root.glob("*/setup.bash"))
    if not known:
        built = Path(sys.prefix, "ros", "bin", "python")
        there = name in (None, "", BUILT) and built.exists()
        return RosDistribution(str(built), environment) if there else None
    setup = _setup(name, known, root)
    found = _sourced(_source(setup, environment))
    if found is None:
        raise UsageError(f"rclpy: {setup} was sourced, and no rclpy is on its paths; install ros-base")
    return found


def graph(environment: Mapping[str, str], domain: int | None) -> dict[str, str]:
    """Return the environment of the graph in full: an unset variable means this machine alone here.

    Raises UsageError for settings that Humble and older do not support; they would ignore later variables.
    """
    found = discovery(environment, domain=domain)
    following = dict(environment) | {"ROS_DOMAIN_ID": str(found.domain)}
    if not found.peers:
        following.pop("ROS_STATIC_PEERS", None)
    if found.distro not in OLD:
        return following | {"ROS_AUTOMATIC_DISCOVERY_RANGE": found.range.value}
    if found.peers or found.range is DiscoveryRange.OFF:
        name = "ROS_STATIC_PEERS" if found.peers else "ROS_AUTOMATIC_DISCOVERY_RANGE=OFF"
        raise UsageError(f"rclpy: {name}: {found.distro} has none; unset it, or take --backend dds")
    return following | {"ROS_LOCALHOST_ONLY": str(int(found.local))}


def profile(environment: Mapping[str, str]) -> dict[str, str]:
    """The variable by which readers of Fast DDS recover a first message; {}: the user has a profile.

    A one-shot publisher ends 0.1 s after its message. If the message arrives before its publisher is
    discovered, the reader requests it again, by default after 70 ms: on a busy machine too late.
    """
    if any(environment.get(name) for name in PROFILES.values()):
        return {}
    version = 2 if environment.get("ROS_DISTRO") in FAST_DDS_2 else 3
    file = Path(__file__).resolve().with_name(f"fast_dds_{version}.xml")
    return {PROFILES[version]: str(file)}


def _setup(distro: str | None, known: Sequence[str], root: Path) -> Path:
    """The set-up script of a distribution in `root`, which has those that are `known`."""
    if not distro and len(known) > 1:
        raise UsageError(f"rclpy: {root} has {', '.join(known)}: choose one with --distro")
    name = distro or known[0]
    if name not in known:
        raise UsageError(f"rclpy: no ROS 2 {name!r} in {root}; there are {', '.join(known)}")
    return root / name / "setup.bash"


def _source(setup: Path, environment: Mapping[str, str]) -> dict[str, str]:
    """The environment after `source SETUP`."""
    script = 'source "$1" >/dev/null && exec env -0'
    try:
        done = subprocess.run(
            ["bash", "-c", script, "bash", str(setup)],
            env=dict(environment),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=SOURCED,
            check=True,
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise UsageError(f"rclpy: `source {setup}` failed: {error}") from None
    pairs = [each.partition("=") for each in done.stdout.decode(errors="surrogateescape").split("\0") if each]
    return {name: value for name, _, value in pairs}


def _sourced(environment: Mapping[str, str]) -> RosDistribution | None:
    """The distribution whose rclpy is on the paths of this environment."""
    prefixes = [each for each in environment.get("AMENT_PREFIX_PATH", "").split(":") if each]
    folders = [each for each in environment.get("PYTHONPATH", "").split(":") if each]
    for prefix in prefixes:
        escaped = glob.escape(prefix)
        folders += sorted(glob.glob(f"{escaped}/lib/python3*/*-packages"))
    for folder in folders:
        if not (Path(folder) / "rclpy" / "__init__.py").is_file():
            continue
        named = _PYTHON.findall(folder)
        name = named[-1] if named else "python3"
        python = _interpreter(name, [f"{each}/bin" for each in prefixes], environment)
        if python is None:
            raise UsageError(f"rclpy: {folder} has it, for {name}, which is not on the PATH; install it")
        return RosDistribution(python, environment)
    return None


def _interpreter(name: str, first: Sequence[str], environment: Mapping[str, str]) -> str | None:
    """Return `name` beside rclpy or on the PATH, outside this installation, whose packages it must ignore."""
    own = os.path.join(sys.prefix, "bin") if sys.prefix != sys.base_prefix else None
    path = [each for each in environment.get("PATH", os.defpath).split(":") if each and each != own]
    return shutil.which(name, path=":".join([*first, *path]))
