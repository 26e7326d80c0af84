"""Limits of this process that commands set as they would in their own; a robot that stands."""

import resource
from collections.abc import Iterator

import pytest

from tests.support.standing_rig import StandingRig


@pytest.fixture(autouse=True)
def data_limit() -> Iterator[None]:
    """`policy check` limits the memory of its process; here the next tests share it."""
    before = resource.getrlimit(resource.RLIMIT_DATA)
    yield
    resource.setrlimit(resource.RLIMIT_DATA, before)


@pytest.fixture
def rig() -> Iterator[StandingRig]:
    """A robot on its feet behind the whole daemon, armed."""
    made = StandingRig()
    made.stand_up()
    yield made
    made.close()
