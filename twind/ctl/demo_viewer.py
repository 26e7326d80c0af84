"""The viewer beside `twindctl demo`: a process of its own, started where its libraries are installed."""

import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import IO

from twind.command_line.extras import how_to_add

ADDRESS = 15.0  # s until it must have printed its address
ENDING = 5.0  # s, after SIGTERM
NICE = 10


@contextmanager
def viewer(folder: str, end_with_us: Callable[[], None]) -> Iterator[None]:
    """`twindctl view` of the daemon in `folder` until the end of the block; its address is printed.

    Begun before that daemon, so that it is done with starting when a robot moves, on a machine with few
    processors. The demonstration goes on without it. `end_with_us`: called in the child, before it starts.
    """
    if find_spec("viser") is None or find_spec("mjviser") is None:
        print(f"view      not installed; for the robot in a browser: {how_to_add('view')}")
        yield
        return
    with tempfile.TemporaryFile() as said:
        command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", folder, "view", "--wait"]
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=said,
            start_new_session=True,
            preexec_fn=lambda: _behind(end_with_us),
        )
        try:
            print(_address(process) or f"view      not there: {_explain_error(said)}")
            yield
        finally:
            _end(process)


def _behind(end_with_us: Callable[[], None]) -> None:
    """In the child: the virtual robot and its daemon share this machine, and have no real time here."""
    os.nice(NICE)
    end_with_us()


def _address(process: "subprocess.Popen[bytes]") -> str:
    """The line with its address; empty where it gave none in time."""
    assert process.stdout is not None
    if not select.select([process.stdout], [], [], ADDRESS)[0]:
        return ""
    return process.stdout.readline().decode(errors="replace").rstrip()


def _explain_error(text: IO[bytes]) -> str:
    text.seek(0)
    lines = text.read().decode(errors="replace").split("\n")
    return next((line for line in reversed(lines) if line), "no address in time")


def _end(process: "subprocess.Popen[bytes]") -> None:
    process.terminate()
    try:
        process.wait(ENDING)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
