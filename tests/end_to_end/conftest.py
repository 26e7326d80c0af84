"""One machine for all tests of this folder: booted for the first, down after the last, also after Ctrl-C."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.systemd import installed
from tests.support.systemd.machine import Machine, why_not
from tests.support.systemd.service import Robot


@pytest.fixture(scope="session")
def machine() -> Iterator[Machine]:
    """A machine on which twind is installed, and was not started yet."""
    if (reason := why_not()) is not None:
        pytest.skip(reason)
    made = Machine(installed.lay, installed.binds())
    try:
        made.boot()
        yield made
    finally:
        made.down()


@pytest.fixture(scope="module")
def robot(machine: Machine, request: pytest.FixtureRequest) -> Iterator[Robot]:
    """A robot of 24 servos for one file, at an adapter of root:dialout 0660."""
    made = Robot(machine, request.module.__name__)
    yield made
    made.close()


@pytest.fixture(scope="module")
def blank_messages() -> Iterator[None]:
    """Processes that the tests of this file start send an `x` instead of each text (tests/support/blanked).

    Bridge and uplink must know a stop and the end of a motion without reading messages.
    """
    blanked = str(Path(__file__).parents[1] / "support" / "blanked")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", blanked, prepend=os.pathsep)
        yield


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
    """Add the state of the machine to the report of a failure."""
    report = yield
    machine = getattr(item, "funcargs", {}).get("machine")
    if report.failed and isinstance(machine, Machine) and machine.init:
        report.sections.append(("journal", machine.diagnostics()))
    return report
