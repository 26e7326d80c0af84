"""A socket that gives one caller one answer."""

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def answering(path: Path, parameters: dict[str, Any]) -> Iterator[None]:
    """A daemon's socket that gives one caller one answer."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(path))
        listener.listen()

        def answer() -> None:
            caller, _ = listener.accept()
            with caller:
                caller.recv(65536)
                caller.sendall(json.dumps({"parameters": parameters}).encode() + b"\0")

        thread = threading.Thread(target=answer)
        thread.start()
        yield
        thread.join(5.0)
