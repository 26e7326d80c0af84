"""The same daemons in real time: over real pseudo-terminals, through the relay, to `twind-virtual`."""

import os
import select
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.proof.busmon.limits import Limits
from tests.proof.busmon.ports import set_baud
from tests.proof.busmon.started import relayed
from tests.proof.evil.daemon_life import Over
from tests.proof.evil.good import Good
from tests.proof.evil.world import BAUD, files

LATE = 0.02  # s: a daemon that the machine kept from running for longer broke rules by no fault of its own
SERVOS = ("--servo", "main:1:XM430-W350", "--servo", "main:2:XM430-W350", "--servo", "main:5:XM430-W350")
OPTIONS = (*SERVOS, "--baud", "2000000", "--muscles", "first-order", "--return-delay", "10")


@contextmanager
def servos(folder: Path) -> Iterator[Path]:
    """Three servos behind a port; its link."""
    command = [sys.executable, "-m", "twind.virtual", *OPTIONS, "--link", str(folder / "ports")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        while (line := process.stdout.readline()) != b"ready\n":
            assert line, "twind-virtual did not start"
        yield folder / "ports" / "main"
        process.stdin.close()


class PtyPort:
    """A port to the relay; words go to its standard input."""

    def __init__(self, relay: Any) -> None:
        self._relay = relay
        self.late = 0.0
        self._fd = os.open(relay.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._fd)
        set_baud(self._fd, BAUD)

    @property
    def now(self) -> float:
        return time.monotonic()

    def write(self, data: bytes) -> None:
        try:
            os.write(self._fd, data)
        except OSError:
            raise Over from None

    def read(self, count: int, timeout: float) -> bytes:
        # the relay and the servos are processes of a busy machine
        data = b""
        end = self.now + timeout + 0.02
        while len(data) < count and self.now < end:
            if not select.select([self._fd], [], [], max(0.0, end - self.now))[0]:
                continue
            try:
                came = os.read(self._fd, 4096)
            except OSError:
                raise Over from None
            if not came:
                raise Over
            data += came
        return data

    def until(self, when: float) -> None:
        time.sleep(max(0.0, when - self.now))
        self.late = max(self.late, self.now - when)

    def say(self, what: str, **facts: Any) -> None:
        if what in ("estop", "state"):
            facts["at"] = self.now
        try:
            self._relay.tell(told=what, **facts)
        except OSError:
            raise Over from None

    def ask_servos(self) -> None:
        """Nothing: only virtual time can ask the servos."""

    @property
    def fd(self) -> int:
        return self._fd

    def close(self) -> None:
        os.close(self._fd)


def tried(daemon: type[Good], folder: Path, servos: Path | str) -> tuple[int, str, bool]:
    """A daemon's life over ptys: the relay's exit code, what it said, and whether the machine kept pace."""
    robot, calibration = files(folder)
    with relayed(folder, servos, robot, calibration, options=("--hearsay", "0.2")) as relay:
        port = PtyPort(relay)
        whole = True
        try:
            daemon(port, Limits.read(robot, calibration, "main")).live()
        except Over:
            pass
        except AssertionError:  # an answer was lost
            whole = False
        time.sleep(0.3)
        port.close()
        code = relay.end()
    return code, relay.printed(), port.late < LATE and (whole or code == 1)
