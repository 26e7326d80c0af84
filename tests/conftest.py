"""Fixtures shared by the tests."""

import atexit
import gc
import importlib
import os
import shutil
import sys
import tempfile
from collections.abc import Generator, Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from hypothesis import settings

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.examples import ALL, FAST, register_profiles

# Else each of a thousand processes compiles all that it imports, and each collection all tests.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Daemons keep what they write (flight recorders) out of the state of this machine.
os.environ["STATE_DIRECTORY"] = tempfile.mkdtemp(prefix="twind-tests-state-")
atexit.register(shutil.rmtree, os.environ["STATE_DIRECTORY"], ignore_errors=True)

register_profiles()
FAST_TESTS = (
    "not slow and not campaign"  # the marker expression of pyproject.toml; another one takes all examples
)


# Begun first: two workers then end together.
LONGEST = ("test_six_minutes_of_a_random_life", "test_three_minutes_without_a_fault")
# Files of end-to-end tests that last longest; each file stays with one worker.
LONGEST_FILES = (
    "test_systemd_robot",
    "test_systemd_packaged",
    "test_docs_tutorial",
    "test_docs_live",
    "test_prove_command",
    "test_calibrate_commands",
    "test_fleet_command",
    "test_sockets_gone",
    "test_reload",
    "test_failsafe_live",
)


END_TO_END = Path(__file__).parent / "end_to_end"
BLANKED = Path(__file__).parent / "support" / "blanked"


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--blank-messages`: every text that a daemon sends is an `x` (tests/support/blanked)."""
    parser.addoption("--blank-messages", action="store_true", help="replace each text for people by an x")


def pytest_configure(config: pytest.Config) -> None:
    """Choose the number of examples. Blank the texts in the workers of xdist and in all processes."""
    settings.load_profile(FAST if config.option.markexpr == FAST_TESTS else ALL)
    if config.getoption("--blank-messages"):
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(BLANKED), os.environ.get("PYTHONPATH"))))
        sys.path.insert(0, str(BLANKED))
        importlib.import_module("blanking").hook()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Import all test modules without the garbage collector, which takes a quarter of that time.

    What is imported stays, so a later collection does not look at it.
    """
    gc.disable()
    collected = yield
    gc.freeze()
    gc.enable()
    return collected


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Add the markers that follow from a test's folder, and run the longest tests first.

    Tests below `end_to_end` use real processes or real time. Those in `concurrent` run two at once, beside
    computation. Those in `wired` use pseudo-terminals, whose bytes a kernel thread carries. Beside
    computation, these bytes arrive up to 0.8 s late (`.ci/run` has the figures), so a few tests run at once
    and nothing else. Those in `exclusive` run alone.
    """
    _one_life_each(items)
    for item in items:
        if item.path.is_relative_to(END_TO_END):
            item.add_marker("realtime")
            if not item.path.is_relative_to(END_TO_END / "concurrent"):
                item.add_marker("wired" if item.path.is_relative_to(END_TO_END / "wired") else "alone")
    items.sort(key=lambda item: not (item.name.startswith(LONGEST) or item.path.stem in LONGEST_FILES))


@cache
def _lives(module: ModuleType) -> bool:
    """Its tests run the whole loop."""
    return any(
        each is MakeRig or (isinstance(each, type) and issubclass(each, Rig))
        for each in vars(module).values()
    )


def _one_life_each(items: list[pytest.Item]) -> None:
    """The first case of a claim about whole lives of the loop; all tests have all cases."""
    begun: set[tuple[Path, str]] = set()
    for item in items:
        campaign = item.get_closest_marker("campaign") is not None
        if isinstance(item, pytest.Function) and _lives(item.module) and not campaign:
            claim = item.path, item.originalname
            if claim in begun:
                item.add_marker("slow")
            elif not item.get_closest_marker("slow"):
                begun.add(claim)


@pytest.fixture
def make_rig() -> Iterator[MakeRig]:
    """Makes daemons of class `kind`, closed when the test ends."""
    with ExitStack() as stack:

        def make(*arguments: Any, kind: type[Rig] = Rig, **options: Any) -> Rig:
            rig = kind(*arguments, **options)
            stack.callback(rig.close)
            return rig

        yield make


@pytest.fixture
def live(make_rig: MakeRig) -> Rig:
    """A daemon in live mode, its port just opened."""
    rig: Rig = make_rig()
    return rig


@pytest.fixture
def armed(live: Rig) -> Rig:
    """Connected, leased and armed."""
    live.arm()
    return live
