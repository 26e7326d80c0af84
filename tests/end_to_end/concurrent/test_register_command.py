"""`twindctl register write`: RAM at once; EEPROM between the lease, `calibrating`, and back again."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.loop_stand_in import StandIn
from twind import link
from twind.client import CallError
from twind.command_line.verb import DONE
from twind.ctl.single_call_commands import REGISTER

WRITTEN = {"name": "Homing Offset", "address": 20, "size": 4, "value": 0}
LEASE = {"holder": "uid 0, pid 1", "uid": 0, "expires_in": 1.0}


class Eeprom(StandIn):
    """A daemon to which a register may be written while it calibrates, and only then."""

    def __init__(self, directory: Path) -> None:
        super().__init__(directory)
        self.reset()

    def reset(self) -> None:
        """Leave the calibrating state, forget the commands, and give the usual answers."""
        self.on = False
        self.commands.clear()
        self.answers = {
            link.WriteRegister: self._written,
            link.Calibrate: self._calibrated,
            link.AcquireLease: lambda c: [link.Reply(ticket=c.ticket, parameters={"lease": LEASE})],
            link.ReleaseLease: lambda c: [link.Reply(ticket=c.ticket)],
        }

    def _written(self, command: Any) -> list[link.Reply]:
        if self.on:
            return [link.Reply(ticket=command.ticket, parameters={"register": WRITTEN})]
        state = {"state": "connected", "allowed": ["calibrating"]}
        return [link.Reply(ticket=command.ticket, error="WrongState", parameters=state)]

    def _calibrated(self, command: Any) -> list[link.Reply]:
        self.on = command.on
        return [link.Reply(ticket=command.ticket, parameters={"state": "calibrating"})]

    @property
    def asked(self) -> list[str]:
        return [type(each).__name__ for each in self.commands if isinstance(each, link.Command)]


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Eeprom]:
    stand_in = Eeprom(tmp_path_factory.mktemp("run"))
    yield stand_in
    stand_in.close()


@pytest.fixture
def daemon(shared: Eeprom) -> Eeprom:
    """The shared daemon as at its start."""
    shared.reset()
    return shared


def write(daemon: StandIn, *words: str) -> int:
    parser = argparse.ArgumentParser()
    REGISTER.add_arguments(parser)
    options = parser.parse_args(["write", "main", "7", "homing_offset", "0", *words])
    options.socket = str(daemon.directory)
    options.json = False
    return REGISTER.run(options)


def test_eeprom_is_written_in_a_calibration_of_its_own(daemon: Eeprom, capsys: Any) -> None:
    assert write(daemon) == DONE
    assert capsys.readouterr().out == "Homing Offset = 0 (address 20, 4 bytes)\n"
    assert daemon.asked == [
        "WriteRegister",
        "AcquireLease",
        "Calibrate",
        "WriteRegister",
        "Calibrate",
        "ReleaseLease",
    ]
    assert not daemon.on


def test_the_calibrating_state_ends_after_a_refused_write(daemon: Eeprom) -> None:
    refused = {"bus": "main", "message": "id 7: Homing Offset: Access Error"}
    first = daemon.answers[link.WriteRegister]

    def answer(command: Any) -> list[link.Reply]:
        if not daemon.on:
            return first(command)
        return [link.Reply(ticket=command.ticket, error="BusFailed", parameters=refused)]

    daemon.answers[link.WriteRegister] = answer
    with pytest.raises(CallError, match="Access Error"):
        write(daemon)
    assert daemon.asked[-2:] == ["Calibrate", "ReleaseLease"]
    assert not daemon.on


@pytest.mark.parametrize("allowed", ["disarmed", "mode live, to write a register"])
def test_a_wrong_state_that_cannot_calibrate_is_reported_without_a_retry(
    daemon: Eeprom, allowed: str
) -> None:
    state = {"state": "armed, torque on", "allowed": [allowed]}
    daemon.answers[link.WriteRegister] = lambda c: [
        link.Reply(ticket=c.ticket, error="WrongState", parameters=state)
    ]
    with pytest.raises(CallError, match="armed, torque on"):
        write(daemon)
    assert daemon.asked == ["WriteRegister"]


def test_a_lease_of_another_client_is_taken_only_with_take(daemon: Eeprom) -> None:
    held = {"lease": LEASE}

    def lease(command: Any) -> list[link.Reply]:
        if command.take:
            return [link.Reply(ticket=command.ticket, parameters=held)]
        return [link.Reply(ticket=command.ticket, error="LeaseHeld", parameters=held)]

    daemon.answers[link.AcquireLease] = lease
    with pytest.raises(CallError, match="--take"):
        write(daemon)
    assert write(daemon, "--take") == DONE
