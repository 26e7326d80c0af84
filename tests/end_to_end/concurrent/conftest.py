"""Begun programs that the tests of a file share: a front process with a stand-in of the loop."""

from collections.abc import Iterator

import pytest

from tests.support.loop_stand_in import StandIn


@pytest.fixture(scope="module")
def front(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StandIn]:
    """The front process of one file, behind it a stand-in of the loop. It lives until the end of the file."""
    stand_in = StandIn(tmp_path_factory.mktemp("front"))
    yield stand_in
    alive = stand_in.front.poll() is None
    assert stand_in.close() == 0
    assert alive


@pytest.fixture
def loop(front: StandIn) -> Iterator[StandIn]:
    """The shared stand-in without recorded commands and with its usual answers. No call breaks the front."""
    front.commands.clear()
    front.paths.clear()
    front.answers.clear()
    yield front
    log = front.log.read_text()
    assert "CALL_BROKE" not in log and "Traceback" not in log
