"""`twindctl video`: a recording of a daemon becomes a video without a display."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("imageio_ffmpeg", reason="make extras EXTRAS=learn")

from tests.support.processes import simulated
from tests.support.videos import decoded
from twind.ctl.ctl_main import main


def test_a_recording_becomes_a_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "a.mcap"
    with simulated(tmp_path / "run", "h24-standing") as daemon:
        socket = ["--socket", str(daemon.sockets)]
        with daemon.client() as client:
            client.call("AcquireLease")
            point = {"positions": [-1.5], "time_from_start": 1.0}
            way = {"joint_names": ["l_shoulder_pitch"], "points": [point], "policy": "retime"}
            stream = client.stream("SubmitTrajectory", trajectory=way)
            next(stream)
            assert main([*socket, "record", "--out", str(file), "--seconds", "1.2"]) == 0
    out = tmp_path / "a.mp4"
    code = main(["video", str(file), str(out), "--fps", "20"])
    error = capsys.readouterr().err
    if "no picture without a display" in error:
        pytest.skip(error)
    assert code == 0, error
    frames, size, fps = decoded(out)
    assert size == (640, 480) and fps == pytest.approx(20.0) and 15 <= len(frames) <= 26
    assert np.abs(frames[0].astype(int) - frames[-1].astype(int)).max() > 50  # the arm has moved
    assert main(["video", str(file), str(out)]) == 1
    assert "is there already" in capsys.readouterr().err
