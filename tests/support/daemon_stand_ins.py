"""Stand-ins for a daemon: sockets that say what a test tells them to, and what comes of an errand."""

import contextlib
import json
import queue
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from twind.observe.viewing.stop_threads import StopOutcome

Answers = Callable[[str], Any]
Daemons = Callable[[str, Answers], "Daemon"]  # the name of a socket, and what it answers


class Daemon:
    """Answers calls as it is told: parameters, an exception's name, or None: never. `asked`: the methods."""

    def __init__(self, path: Path, answers: Answers) -> None:
        self.asked: list[str] = []
        self.ended: queue.Queue[str] = queue.Queue()  # a connection was closed
        self._answers = answers
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.bind(str(path))
        self._socket.listen()
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._socket.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        buffer = b""
        with client:
            while data := client.recv(65536):
                buffer += data
                while b"\0" in buffer:
                    message, _, buffer = buffer.partition(b"\0")
                    method = json.loads(message)["method"].rpartition(".")[2]
                    self.asked.append(method)
                    answer = self._answers(method)
                    if answer is not None:
                        client.sendall(json.dumps(answer).encode() + b"\0")
        self.ended.put("closed")

    def close(self) -> None:
        self._socket.close()


@contextlib.contextmanager
def answering(folder: Path) -> Iterator[Daemons]:
    """Makes daemons that listen in the folder, until it ends."""
    made: list[Daemon] = []

    def make(name: str, answers: Answers) -> Daemon:
        made.append(Daemon(folder / f"{name}.sock", answers))
        return made[-1]

    yield make
    for each in made:
        each.close()


def next_outcome(outcomes: "queue.Queue[StopOutcome]", seconds: float = 5.0) -> StopOutcome:
    """The next outcome; `queue.Empty` where none comes."""
    return outcomes.get(timeout=seconds)
