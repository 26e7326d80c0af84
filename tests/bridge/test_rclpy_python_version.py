"""Modules under a distribution's interpreter: standard library, rclpy and twind, all of it Python 3.10."""

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.support import interpreters

ROOT = Path(__file__).parents[2]
STAND_IN = ROOT / "tests/support/ros_stand_in"

# Prints the files of all modules that the back end loads.
LOAD = """
import json, sys
import twind.bridge.ros.rclpy_main
files = {name: getattr(module, "__file__", None) for name, module in sys.modules.items()}
print(json.dumps({name: file for name, file in files.items() if file}))
"""


@cache
def loaded(python: str) -> dict[str, str]:
    """Modules and their files, with the stand-in. Whatever warns is an error."""
    environment = os.environ | {"PYTHONPATH": f"{STAND_IN}:{ROOT}"}
    words = [python, "-S", "-W", "error", "-c", LOAD]  # -S: no site-packages, ours neither
    done = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found: dict[str, str] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("version", ["3.10", "3.11", "3.12", "3.13"])
def test_the_rclpy_process_loads_only_the_standard_library_rclpy_and_twind(version: str) -> None:
    found = loaded(interpreters.python(version))
    ours = {name for name in found if name.partition(".")[0] == "twind"}
    assert {"twind.bridge.ros.ros_bridge", "twind.bridge.ros.rclpy_node"} <= ours
    # Where a module is no stand-in's and none of ours, it came without site-packages: the library's.
    foreign = [name for name in ours if name.startswith(("twind.bridge.ros.dds", "twind.bridge.ros.zenoh"))]
    assert foreign == []
    assert not {"numpy", "msgspec", "rich", "yaml"} & found.keys()


def test_the_types_of_the_rclpy_process_check_under_python_3_10() -> None:
    ours = [file for name, file in loaded(sys.executable).items() if name.partition(".")[0] == "twind"]
    words = [sys.executable, "-m", "mypy", "--python-version", "3.10", *ours]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
