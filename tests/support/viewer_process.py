"""`twindctl view` as a process, its address, and presses of the buttons on its page."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.support.processes import twindctl

WAIT = 60_000  # ms that a busy machine may be behind
TRIES = 5  # of a motion that a busy machine ends


@contextmanager
def viewing(folder: Path, *options: str) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """A viewer of the daemon with its sockets in this folder, and the address of its page."""
    with twindctl("--socket", str(folder), "view", *options) as process:
        assert process.stdout is not None
        yield process, process.stdout.readline().split()[1]


def press(page: Any, name: str) -> None:
    """As an event: a pointer waits until a page stands still, which takes long without a graphics card."""
    page.get_by_role("button", name=name, exact=True).dispatch_event("click", timeout=WAIT)
