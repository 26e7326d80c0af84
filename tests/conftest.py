"""Fixtures shared by the tests."""

import atexit
import importlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # tests/rig.py and its like

from hypothesis import settings
from rig import Rig

# Else each of a thousand processes compiles all that it imports, and each collection all tests.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Daemons keep what they write (flight recorders) out of the state of this machine.
os.environ["STATE_DIRECTORY"] = tempfile.mkdtemp(prefix="twind-tests-state-")
atexit.register(shutil.rmtree, os.environ["STATE_DIRECTORY"], ignore_errors=True)

# How long an example takes says how busy the machine is: no test here claims it.
settings.register_profile("twind", deadline=None)
settings.load_profile("twind")


# Begun first: two workers then end together.
LONGEST = ("test_six_minutes_of_a_random_life", "test_three_minutes_without_a_fault")


# Real processes whose claim is no time, or one of seconds: these run two at once, beside computing that has
# only what nobody else wants.
SIDE_BY_SIDE = """
    activation bridges can_socketcan check_offline cli client codes_reached ctl_main docs_ros
    doctor_can_links doctor_files doctor_machine doctor_ports fleet_line flight_live flight_ring
    front_find_stop front_limits front_log front_reload front_server front_streams front_telemetry fuzz
    latency_live learn_batch_vec_env learn_training loop_notify machine metrics_live picture_live
    policy_live prose_live register_verb remote_live ros_command_line ros_course ros_dds ros_dds_live
    ros_flood
    ros_live ros_zenoh ros_zenoh_live ros_zenoh_services service service_files stream_camera stream_ingest
    stream_keeping stream_live stream_sender streams uplink_lanes uplink_live uplink_lost uplink_secret
    uplink_together view_door view_fleet view_fleet_live view_news view_operate view_stops
    virtual_servos zenoh_session
"""

# The same, but what they say goes over pseudo-terminals, whose bytes a thread of the kernel carries: beside
# computing it comes late by up to 0.8 s (.ci/run has the figures). Two at once, and nothing else. Who stands
# in neither list has the machine to itself.
WIRED = """
    adopt_verb calibrate_import_verb calibrate_scan calibrate_verbs descriptors docs docs_tutorial doctor
    doctor_can_line doctor_daemon doctor_fix_live doctor_mend doctor_supply edited failsafe_live fleet_live
    front_process h24_mixed_live imu_live loop_slow_answers_live many model_live monitor_live packaged plug
    prove_verb record_live recorder reload_live replug robot scan_verb sockets_gone virtual_can_clients
    virtual_child virtual_clients virtual_main virtual_serve wiggle_verb
"""


BLANKED = Path(__file__).parent / "blanked"


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--blank-messages`: no text that a daemon sends says anything (tests/blanked)."""
    parser.addoption("--blank-messages", action="store_true", help="replace each text for people by an x")


def pytest_configure(config: pytest.Config) -> None:
    """Also in the workers of xdist, and in all processes that the tests start."""
    if config.getoption("--blank-messages"):
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(BLANKED), os.environ.get("PYTHONPATH"))))
        sys.path.insert(0, str(BLANKED))
        importlib.import_module("blanking").hook()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Where only tests in real time are asked for, files that have none are not read: most of them."""
    file = collection_path.suffix == ".py" and collection_path.name.startswith("test_")
    if file and config.option.markexpr.startswith(("realtime", "alone", "wired")):
        return True if "realtime" not in collection_path.read_text() else None
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The order of everything else stays."""
    shared, wired = (_files(names) for names in (SIDE_BY_SIDE, WIRED))
    _one_life_each(items)
    for item in items:
        if item.get_closest_marker("realtime") and item.path.name not in shared:
            item.add_marker("wired" if item.path.name in wired else "alone")
    items.sort(key=lambda item: not item.name.startswith(LONGEST))


def _files(names: str) -> set[str]:
    return {f"test_{name}.py" for name in names.split()}


@cache
def _lives(module: ModuleType) -> bool:
    """Its tests run the whole loop."""
    return any(isinstance(each, type) and issubclass(each, Rig) for each in vars(module).values())


def _one_life_each(items: list[pytest.Item]) -> None:
    """Of a claim about whole lives of the loop the fast tests have the first case, all tests have all."""
    begun: set[tuple[Path, str]] = set()
    for item in items:
        if isinstance(item, pytest.Function) and _lives(item.module):
            claim = item.path, item.originalname
            if claim in begun:
                item.add_marker("slow")
            elif not item.get_closest_marker("slow"):
                begun.add(claim)


@pytest.fixture
def live() -> Iterator[Rig]:
    """A daemon in live mode, its port just opened."""
    rig = Rig()
    yield rig
    rig.close()


@pytest.fixture
def armed(live: Rig) -> Rig:
    """Connected, leased and armed."""
    live.arm()
    return live
