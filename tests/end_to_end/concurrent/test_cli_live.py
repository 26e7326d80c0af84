"""Real-time tests of cli."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No settings, calibration or folder of this machine."""
    for key in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_RUNTIME_DIR", "HOME"):
        monkeypatch.setenv(key, str(tmp_path / key))
    own = os.geteuid() or 12345  # a folder of root's is as good as one of ours
    monkeypatch.setattr("os.geteuid", lambda: own)
    monkeypatch.setattr("faulthandler.enable", lambda fd: None)  # the test run has its own


def test_the_end_asks_for_the_time_that_lowering_takes_and_the_start_names_the_groups(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(30)
        daemon = subprocess.Popen(
            [sys.executable, "-m", "twind.cli", "--mode", "sim", "--socket", str(tmp_path / "run")],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify")},
        )
        while b"READY=1" not in manager.recv(4096):
            pass
        daemon.terminate()
        while b"STOPPING=1" not in (told := manager.recv(4096)):
            pass
        _, log = daemon.communicate(timeout=30)
    assert daemon.returncode == 0
    assert told.split() == [b"STOPPING=1", b"EXTEND_TIMEOUT_USEC=30000000"]
    assert "control socket for group " in log
