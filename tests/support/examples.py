"""The number of generated examples: all in `make check`, a quarter in the fast tests."""

from typing import Any

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
