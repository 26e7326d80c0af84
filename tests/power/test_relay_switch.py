"""The relay behind a device that may come and go; a pseudo-terminal is the USB relay."""

from pathlib import Path

import pytest

from tests.support.pty_wire import PtyWire
from twind.power.power_states import RelayState
from twind.power.relay_switch import AGAIN, LCUS_OFF, LCUS_ON, RelaySwitch


def test_the_order_of_the_relay_is_that_of_its_protocol(tmp_path: Path) -> None:
    wire = PtyWire(tmp_path / "relay")
    switch = RelaySwitch("lcus1", str(wire.path))
    assert switch.drive(False, 10.0) is RelayState.OPEN
    assert wire.read() == bytes.fromhex("a00100a1")
    assert switch.drive(True, 10.01) is RelayState.CLOSED
    assert wire.read() == bytes.fromhex("a00101a2")
    assert switch.drive(True, 10.02) is RelayState.CLOSED
    assert wire.read() == b""
    switch.drive(True, 10.01 + AGAIN)
    assert wire.read() == LCUS_ON, "a relay that missed the order gets it again"
    switch.release()
    wire.unplug()


def test_a_lost_relay_is_reported_and_gets_its_order_once_it_is_back(tmp_path: Path) -> None:
    wire = PtyWire(tmp_path / "relay")
    switch = RelaySwitch("lcus1", str(wire.path))
    switch.drive(True, 10.0)
    wire.unplug()
    assert switch.drive(False, 10.01) is RelayState.FAILED
    assert str(wire.path) in switch.trouble
    assert switch.drive(False, 10.02) is RelayState.FAILED
    wire = PtyWire(tmp_path / "relay")
    assert switch.drive(False, 10.01 + AGAIN) is RelayState.OPEN
    assert wire.read() == LCUS_OFF
    assert switch.trouble == ""
    switch.release()
    wire.unplug()


def test_a_port_that_another_process_has_is_not_shared(tmp_path: Path) -> None:
    wire = PtyWire(tmp_path / "relay")
    first = RelaySwitch("lcus1", str(wire.path))
    assert first.drive(False, 10.0) is RelayState.OPEN
    assert RelaySwitch("lcus1", str(wire.path)).drive(True, 10.0) is RelayState.FAILED
    first.release()
    wire.unplug()


@pytest.mark.parametrize(("kind", "text"), [("rts", "relay rts at"), ("gpio", "relay gpio at")])
def test_a_device_without_such_a_line_is_a_failure_with_its_name(
    tmp_path: Path, kind: str, text: str
) -> None:
    wire = PtyWire(tmp_path / "relay")  # a pseudo-terminal has neither RTS nor GPIO lines
    switch = RelaySwitch(kind, str(wire.path), 4)
    assert switch.drive(False, 10.0) is RelayState.FAILED
    assert text in switch.trouble
    wire.unplug()


def test_an_order_that_a_port_takes_no_more_is_sent_by_the_port_that_replaced_it(tmp_path: Path) -> None:
    wire = PtyWire(tmp_path / "relay")
    switch = RelaySwitch("lcus1", str(wire.path))
    switch.drive(True, 10.0)
    wire.unplug()
    wire = PtyWire(tmp_path / "relay")
    assert switch.drive(False, 10.01) is RelayState.OPEN
    assert wire.read() == LCUS_OFF
    switch.release()
    wire.unplug()
