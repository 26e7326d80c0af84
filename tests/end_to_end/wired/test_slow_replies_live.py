"""Servos as delivered (`twind-virtual --return-delay 500`), mended by the commands of log and doctor."""

import re

import pytest

from tests.support.processes import Daemon, daemon, robot, until
from twind.command_line.verb import write_register
from twind.ctl.ctl_main import main


def printed(running: Daemon) -> list[str]:
    """Words of the command in the log for the first servo."""

    def look() -> list[str] | None:
        found = re.search(r"`twindctl (register write \S+ 1 return_delay_time \d+)`", running.log.read_text())
        return found[1].split() if found else None

    return until(look, 10.0, "no return delay in the log")


def delays(running: Daemon, *ids: int) -> set[int]:
    """Values of the register in these servos."""
    with running.client() as client:
        call = {"bus": "main", "name": "return_delay_time"}
        return {client.call("ReadRegister", id=id, **call)["register"]["value"] for id in ids}


# Fast reads (46) work with the delay. Without them (44) the servos are not identified before it is mended.
@pytest.mark.parametrize("firmware", ["46", "44"])
def test_slow_servos_are_mended_by_the_command_in_the_log_and_by_the_doctor(
    firmware: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--return-delay", "500", "--firmware", firmware, "--muscles", "first-order")
    with robot("h24", *options) as (virtual, folder), daemon(virtual, folder) as running:
        words = printed(running)
        running.reach(10.0, state="connected" if firmware == "46" else "identifying")
        socket = ("--socket", str(running.sockets))
        assert delays(running, 1, 12) == {250}
        assert main([*socket, *words]) == 0, capsys.readouterr().err
        if firmware == "46":
            code = main([*socket, "doctor", "--only", "RETURN_DELAY", "--fix", "--yes"])
            assert code == 0, capsys.readouterr()
        else:
            with running.client() as client:
                for id in range(2, 25):
                    write_register(client, bus="main", id=id, name="return_delay_time", value=int(words[-1]))
        assert delays(running, 1, 12, 24) == {5}
        status = running.reach(10.0, state="connected")
        assert (status["lease"], status["armed"]) == (None, False)
        log = running.log.read_text()
        assert "None" not in log
        assert "DEVICE_MISSING" not in log
        assert not any(servo["torque"] for servo in virtual.servos())
