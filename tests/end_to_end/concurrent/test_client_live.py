"""Real-time tests of client."""

import socket
import time
from pathlib import Path

import pytest

from twind.client import (
    Client,
    NoAnswer,
)


def test_silence_ends_in_an_error_and_a_closed_connection(tmp_path: Path) -> None:
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "control.sock"))
    listener.listen()
    began = time.monotonic()
    with (
        Client(tmp_path, timeout=0.05) as client,
        pytest.raises(NoAnswer, match=r"GetStatus: .* within 0.05 s"),
    ):
        client.call("GetStatus")
    assert time.monotonic() - began < 5.0
    connection, _ = listener.accept()
    with connection, listener:
        assert connection.recv(100).endswith(b"\0")
        assert connection.recv(100) == b""
