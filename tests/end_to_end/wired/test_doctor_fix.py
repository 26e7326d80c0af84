"""`twindctl doctor --fix` beside a running daemon: EEPROM is written in a calibration of its own."""

from typing import Any

import pytest

from tests.support.processes import daemon, robot
from twind.ctl.ctl_main import main


def test_a_slow_servo_is_mended_while_the_daemon_runs(capsys: pytest.CaptureFixture[str]) -> None:
    with robot("h24", "--return-delay", "500") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(10.0, state="connected")

        def delays() -> set[Any]:
            with running.client() as client:
                call = {"bus": "main", "name": "return_delay_time"}
                found = [client.call("ReadRegister", id=id, **call) for id in (1, 12, 24)]
            return {each["register"]["value"] for each in found}

        assert delays() == {250}
        words = ["--socket", str(running.sockets), "doctor", "--only", "RETURN_DELAY", "--fix", "--yes"]
        code = main(words)
        said = capsys.readouterr()
        assert code == 0, said.out + said.err
        assert delays() == {5}
        status = running.reach(10.0, state="connected")
        assert (status["lease"], status["armed"]) == (None, False)
