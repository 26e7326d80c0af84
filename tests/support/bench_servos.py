"""Single virtual servos on a pseudo-terminal, for clients that others wrote."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def bench_servos(folder: Path, baud: int, servos: Sequence[str], *options: str) -> Iterator[Path]:
    """The port of a running `twind-virtual` with these `--servo` on one bus, called `main`."""
    command = [sys.executable, "-m", "twind.virtual", "--link", str(folder), "--baud", str(baud), *options]
    command += [part for servo in servos for part in ("--servo", servo)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        while process.stdout.readline().strip() != b"ready":
            assert process.poll() is None
        yield folder / "main"
        process.communicate()
    assert process.returncode == 0
