"""Fixtures of the doctor's tests."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.doctor_rig import copy_h24


@pytest.fixture
def pty() -> Iterator[str]:
    """Path of a port that exists, is free and sends nothing."""
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """Robot file of a copy of h24, which a test may change."""
    return copy_h24(tmp_path)
