"""Fixtures shared by the tests."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # tests/rig.py and its like

from hypothesis import settings
from rig import Rig

# Else each of a thousand processes compiles all that it imports, and each collection all tests.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# How long an example takes says how busy the machine is: no test here claims it.
settings.register_profile("twind", deadline=None)
settings.load_profile("twind")


LONGEST = "test_five_minutes_of_robot"  # begun first: two workers then end together


# Real processes whose claim is no time, and of which none holds up a robot: these run two at once.
SIDE_BY_SIDE = """
    activation adopt_verb calibrate_scan can_socketcan check_offline cli client codes_reached
    ctl_main doctor_can_line doctor_can_links doctor_files doctor_machine doctor_mend doctor_ports
    edited front_log front_process front_reload front_server front_telemetry fuzz loop_notify machine many
    metrics_live packaged plug reload_live scan_verb service service_files streams virtual_can_clients
    virtual_child virtual_clients virtual_main virtual_serve virtual_servos
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The order of everything else stays."""
    shared = {f"test_{name}.py" for name in SIDE_BY_SIDE.split()}
    for item in items:
        if item.get_closest_marker("realtime") and item.path.name not in shared:
            item.add_marker("alone")
    items.sort(key=lambda item: not item.name.startswith(LONGEST))


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
