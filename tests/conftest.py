"""Fixtures shared by the tests."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # tests/rig.py and its like

from hypothesis import settings
from rig import Rig

# How long an example takes says how busy the machine is: no test here claims it.
settings.register_profile("twind", deadline=None)
settings.load_profile("twind")


LONGEST = "test_an_hour_of_robot"  # begun first: two workers then end together


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The order of everything else stays."""
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
