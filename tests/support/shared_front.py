"""One front process shared by the tests of a file; each test sees only its own commands and log lines."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.support.loop_stand_in import StandIn
from tests.support.raw_connection import Raw
from twind import link


class SharedFront(StandIn):
    """A stand-in for the loop with its front, used by one test after the other."""

    _seen = 0

    def begin(self) -> None:
        """Forget the commands, answers and log lines of earlier tests, once their connections are closed."""
        time.sleep(0.05)
        with Raw(self, "observe") as client:
            client.call("GetStatus")
        time.sleep(0.03)  # the ends of connections reach the stand-in at its next tick
        self.forget()

    def forget(self) -> None:
        """Forget the commands, answers and log lines until now."""
        self.commands.clear()
        self.paths.clear()
        self.answers.clear()
        self._seen = self.log.stat().st_size

    def logged(self) -> str:
        """Log lines since `forget`: those of the running test."""
        return self.log.read_bytes()[self._seen :].decode()

    def submits(self) -> list[link.Submit]:
        """Trajectories that have reached the loop, checks among them."""
        return [command for command in self.commands if isinstance(command, link.Submit)]


@contextmanager
def shared_front(folder: Path, **given: bytes) -> Iterator[SharedFront]:
    """A front with these options of `StandIn`. It must run to the end, with no broken call in its log."""
    made = SharedFront(folder, **given)  # type: ignore[arg-type]
    yield made
    assert made.front.poll() is None
    assert made.close() == 0
    assert "CALL_BROKE" not in made.log.read_text()


def time_stop(loop: StandIn, name: str = "observe") -> float:
    """Return the seconds from connecting to socket `name` until the reply to an e-stop."""
    began = time.monotonic()
    with Raw(loop, name) as client:
        answer = client.call("EStop")
    assert "error" not in answer, answer
    return time.monotonic() - began
