"""Servos as delivered (`twind-virtual --return-delay 500`) in real time; the command that the log prints."""

import re
import subprocess
import sys

import pytest

from tests.support.processes import Daemon, daemon, robot, until
from twind.command_line.verb import write_register


def printed(running: Daemon) -> list[str]:
    """What the log says to type, for the first servo."""

    def look() -> list[str] | None:
        found = re.search(r"`twindctl (register write \S+ 1 return_delay_time \d+)`", running.log.read_text())
        return found[1].split() if found else None

    return until(look, 10.0, "no return delay in the log")


@pytest.mark.parametrize("firmware", ["46", "44"])  # with fast reads, and without: then it is not read at all
def test_servos_as_delivered_are_found_and_mended_by_the_printed_command(firmware: str) -> None:
    options = ["--return-delay", "500", "--firmware", firmware]
    with robot("h24", *options) as (virtual, folder), daemon(virtual, folder) as running:
        words = printed(running)
        state = "connected" if firmware == "46" else "identifying"
        running.reach(10.0, state=state)
        command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(running.sockets)]
        run = subprocess.run([*command, *words], capture_output=True, text=True, timeout=20.0)
        assert run.returncode == 0, run.stderr
        with running.client() as client:
            for id in range(2, 25) if firmware == "44" else ():
                call = {"bus": "main", "id": id, "name": "return_delay_time", "value": int(words[-1])}
                write_register(client, **call)
        running.reach(10.0, state="connected")
        log = running.log.read_text()
        assert "None" not in log
        assert "DEVICE_MISSING" not in log
        assert not any(servo["torque"] for servo in virtual.servos())
