"""The number of generated examples and similar cases: all in `make check`, a share in the fast tests."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest
from hypothesis import settings

# Names of the profiles that tests/conftest.py loads.
ALL = "all"
FAST = "fast"
FULL_SHARE = 100  # examples of a test that names no number, by hypothesis


def register_profiles() -> None:
    """Define both profiles. The time of an example depends on the machine's load, so none has a deadline."""
    settings.register_profile(ALL, deadline=None, max_examples=FULL_SHARE)
    settings.register_profile(FAST, deadline=None, max_examples=FULL_SHARE // 4)


def examples(count: int, **others: Any) -> settings:
    """Settings for `count` examples, or for the share of them that the loaded profile takes."""
    share = max(1, count * settings().max_examples // FULL_SHARE)
    return settings(max_examples=share, **others)


def fast_cases(values: Iterable[Any], fast: Collection[Any]) -> list[Any]:
    """Values for `parametrize`. The fast tests take those in `fast`, `make check` takes all."""
    slow = pytest.mark.slow
    rows = ((each, each if type(each) is tuple else (each,)) for each in values)
    return [each if each in fast else pytest.param(*row, marks=slow) for each, row in rows]
