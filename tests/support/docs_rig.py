"""Helpers shared by the computed and the real-time tests of docs."""

import subprocess
import time
from pathlib import Path

from tests.support.doc_pages_text import README, fenced
from tests.support.processes import BUSY, until
from twind.client import Client, ClientError

# A shared machine may stop everybody for a tenth of a second; the daemon then holds and says so, as it must.
# What is claimed here is that the commands do what the page says on a machine that lets them.
TRIES = 8


def run(command: str, folder: Path, environment: dict[str, str], seconds: float = 40.0) -> str:
    for _ in range(TRIES):
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=seconds,
        )
        if not any(code in done.stderr for code in BUSY):
            break
        time.sleep(1.0)
    assert done.returncode == 0, (command, done.stdout, done.stderr)
    return done.stdout


def readme_lines() -> list[str]:
    return [line for block in fenced(README, "sh") for line in block.splitlines()]


def wait_for(runtime: Path, **wanted: object) -> None:
    """Wait until the status of the daemon below this runtime folder has these values."""

    def is_reached() -> bool:
        try:
            with Client(runtime / "twind") as client:
                status = client.call("GetStatus")["status"]
        except ClientError:
            return False
        return all(status[key] == value for key, value in wanted.items())

    log = runtime / "log"
    until(is_reached, 30.0, lambda: f"{wanted}: {log.read_text() if log.exists() else ''}")
