"""A model that took minutes of motion is printed also where its file cannot be written."""

import errno
import os
from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace

import pytest

from twind.command_line.verb import Rejected
from twind.config.identified_spec import IdentifiedModel
from twind.identification import identify_run

MODEL = IdentifiedModel("odd", "2026-11-29T00:00:00Z", "twind", "live", 60.0, 0.0, {})


@pytest.mark.parametrize(
    ("code", "remedy"),
    [(errno.ENOSPC, "free space on that disk"), (errno.EROFS, "mount that file system writable")],
)
def test_the_figures_of_a_model_that_cannot_be_written_are_not_lost(
    code: int,
    remedy: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(*_: object) -> Path:
        raise OSError(code, os.strerror(code))

    found = SimpleNamespace(model=MODEL, before=(), after=(), still=())
    monkeypatch.setattr(identify_run, "_fit", lambda *_: found)
    for name in ("require_place", "open_recording", "recorded_motion", "_files"):
        monkeypatch.setattr(identify_run, name, lambda *_: SimpleNamespace(robot=None))
    monkeypatch.setattr(identify_run, "save_identified", fail)
    options = Namespace(write=True, calibration=tmp_path / "odd.yaml", json=True)
    with pytest.raises(Rejected, match=f"odd.identified.yaml cannot be written: .*; {remedy}"):
        identify_run.identify_files(options, [tmp_path / "odd.mcap"])
    assert '"robot": "odd"' in capsys.readouterr().out.replace('":"', '": "')
