"""Begun programs that the tests of a file share: a front process with a stand-in of the loop."""

from collections.abc import Iterator

import pytest

from tests.support.shared_front import SharedFront, shared_front


@pytest.fixture(scope="module")
def front(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedFront]:
    """The front process of one file, behind it a stand-in of the loop. It lives until the end of the file."""
    with shared_front(tmp_path_factory.mktemp("front")) as made:
        yield made


@pytest.fixture
def loop(front: SharedFront) -> Iterator[SharedFront]:
    """The shared stand-in without recorded commands and with its usual answers. No call breaks the front."""
    front.forget()
    yield front
    log = front.logged()
    assert "CALL_BROKE" not in log and "Traceback" not in log
