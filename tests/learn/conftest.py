"""Limits of this process that commands set as they would in their own."""

import resource
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def data_limit() -> Iterator[None]:
    """`policy check` limits the memory of its process; here the next tests share it."""
    before = resource.getrlimit(resource.RLIMIT_DATA)
    yield
    resource.setrlimit(resource.RLIMIT_DATA, before)
