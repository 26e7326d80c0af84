"""A pytest plugin: only tests of the pure core, without clock or chance: the same verdict each time."""

import hypothesis
import pytest

DAEMON = {"live", "armed"}  # fixtures of tests/conftest.py that are a whole daemon


def pytest_configure() -> None:
    """Generated examples: the same ones each time, none stored, none made smaller, no clock."""
    hypothesis.settings.register_profile(
        "calm",
        derandomize=True,
        database=None,
        deadline=None,
        phases=(hypothesis.Phase.explicit, hypothesis.Phase.generate),
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    hypothesis.settings.load_profile("calm")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of the whole daemon stay out: the room's own tests must do."""
    items[:] = [item for item in items if not DAEMON & set(getattr(item, "fixturenames", ()))]
