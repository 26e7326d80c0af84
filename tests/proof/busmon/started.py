"""For tests: a relay with its monitor, started between a virtual robot and whoever takes its port."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

HOME = Path(__file__).resolve().parents[3]  # where `tests` is found


class Relayed:
    """A running relay. `link` is the port to give to the daemon."""

    def __init__(
        self,
        folder: Path,
        servos: Path | str,
        robot: Path,
        calibration: Path,
        *,
        bus: str = "main",
        observe: Path | None = None,
        options: tuple[str, ...] = (),
    ) -> None:
        self.link = folder / f"relay-{bus}"
        self.output = folder / f"relay-{bus}.txt"
        command = [
            sys.executable,
            "-m",
            "tests.proof.busmon",
            "--servos",
            str(servos),
            "--link",
            str(self.link),
        ]
        command += ["--robot", str(robot), "--calibration", str(calibration), "--bus", bus, *options]
        if observe is not None:
            command += ["--observe", str(observe)]
        environment = {**os.environ, "PYTHONPATH": str(HOME)}
        with self.output.open("wb") as output:
            self.process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=output, stderr=output, env=environment
            )

    def wait(self, seconds: float = 10.0) -> None:
        """Until the port is there."""
        end = time.monotonic() + seconds
        while not self.link.exists():
            assert self.process.poll() is None and time.monotonic() < end, self.printed()
            time.sleep(0.01)

    def tell(self, **line: Any) -> None:
        """A line on its standard input; one that ended by itself hears it no more (see `caught`)."""
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):
            self.process.stdin.write(json.dumps(line).encode() + b"\n")
            self.process.stdin.flush()

    def printed(self) -> str:
        return self.output.read_text()

    @property
    def caught(self) -> bool:
        """It has ended by itself: something was wrong."""
        return self.process.poll() is not None

    def counts(self) -> dict[str, Any]:
        """Its last line."""
        found: dict[str, Any] = json.loads(self.printed().splitlines()[-1])
        return found

    def end(self) -> int:
        """Close its input, wait for its end; its exit code."""
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):
            self.process.stdin.close()
        return self.process.wait(10)


@contextmanager
def relayed(
    folder: Path, servos: Path | str, robot: Path, calibration: Path, **options: Any
) -> Iterator[Relayed]:
    """A relay that is ended at the end."""
    relay = Relayed(folder, servos, robot, calibration, **options)
    try:
        relay.wait()
        yield relay
    finally:
        relay.end()
