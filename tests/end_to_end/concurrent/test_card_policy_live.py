"""A recurrent policy of another framework drives a daemon in mode sim through the gate."""

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.card_files import STANDING, STANDING_LSTM, carded, lstm
from tests.support.policy_files import Run
from tests.support.processes import Daemon, simulated


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    with simulated(tmp_path_factory.mktemp("run"), "h24-standing") as running:
        yield running


def test_a_recurrent_policy_with_a_card_drives_and_gives_the_lease_back(
    daemon: Daemon, tmp_path: Path
) -> None:
    run = Run(daemon, carded(tmp_path, lstm(7, 4), STANDING + STANDING_LSTM), "--seconds", "2")
    code, told, errors = run.end()
    assert code == 0 and told["as_asked"], (told, errors)
    assert told["refused"] == 0 and told["steps"] > 20 and told["most_tilt_deg"] < 20.0
    assert daemon.status()["lease"] is None


def test_an_e_stop_ends_the_drive(daemon: Daemon, tmp_path: Path) -> None:
    """The next run is a new process: its recurrent state is zero."""
    run = Run(daemon, carded(tmp_path, lstm(7, 4), STANDING + STANDING_LSTM))
    run.drives()
    with daemon.client() as client:
        client.call("EStop")
        code, told, _ = run.end()
        assert code == 1 and not told["as_asked"], told
        client.call("Reset")
    assert daemon.status()["lease"] is None
