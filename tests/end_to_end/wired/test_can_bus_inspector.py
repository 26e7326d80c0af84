"""The doctor puts no frame on a CAN bus that a daemon may drive: real channels, a planted /proc."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.doctor_rig import host, plant
from twind.client import Client, NoDaemon
from twind.config.robot_file import load_robot
from twind.doctor.host_inspector import HostInspector
from twind.exceptions import OperationFailed
from twind_drivers.can.doctor.can_bus_checks import survey_can_line
from twind_drivers.can.doctor.can_bus_inspector import CanBusInspector
from twind_drivers.clock import MonotonicClock
from twind_drivers.ports.can_ports import open_channel
from twind_drivers.ports.channel import CanChannel

ROBOT = load_robot("h24-mixed")
LEG = ROBOT.bus("l_leg")
HEARD = """
receive list 'rx_all':
  (any: no entry)
  device   can_id   can_mask  function  userdata   matches  ident
   {0}     000    00000000  0000000000000000  0000000000000000        42  raw
"""
NOBODY_HEARS = "\nreceive list 'rx_all':\n  (any: no entry)\n  (can0: no entry)\n"


@pytest.fixture
def lonely(tmp_path: Path) -> HostInspector:
    """A machine on which nobody else runs."""
    plant(tmp_path / "proc/locks", "")
    return host(proc=tmp_path / "proc")


@pytest.fixture
def wire() -> Iterator[CanChannel]:
    """Another's end of a CAN bus inside this process."""
    channel = open_channel(f"can:virtual:doctor{os.getpid()}", LEG.baud)
    yield channel
    channel.close()


def line(on: HostInspector, port: str, why: NoDaemon | None = None) -> CanBusInspector:
    return CanBusInspector(port, LEG, ROBOT, on, MonotonicClock(), why)


def why(place: object) -> NoDaemon:
    """Result of a real connection attempt."""
    with pytest.raises(NoDaemon) as caught:
        Client(str(place), timeout=1.0).connect()
    return caught.value


def test_a_can_bus_without_a_user_is_opened_and_queried(
    lonely: HostInspector, wire: CanChannel, tmp_path: Path
) -> None:
    one = line(lonely, f"can:virtual:doctor{os.getpid()}", why(tmp_path))
    assert survey_can_line(one).nodes == ()
    one.close()
    assert len(wire.receive(0.0)) > 0


def test_beside_a_daemon_that_runs_no_frame_is_sent(
    lonely: HostInspector, wire: CanChannel, tmp_path: Path
) -> None:
    plant(lonely.proc / "4242/cmdline", "/opt/twind/bin/python\0/opt/twind/bin/twind\0--config\0a.yaml\0")
    one = line(lonely, f"can:virtual:doctor{os.getpid()}", why(tmp_path))
    with pytest.raises(
        OperationFailed, match=r"was not opened, pid 4242 \(.*bin/twind .*may drive it: ask that"
    ):
        survey_can_line(one)
    assert len(wire.receive(0.0)) == 0


def test_a_daemon_that_may_not_be_asked_may_drive_the_bus(lonely: HostInspector, wire: CanChannel) -> None:
    denied = NoDaemon("/run/twind/control.sock: permission denied: operators are in the group")
    with pytest.raises(OperationFailed, match=r"a daemon may drive it: .*permission denied"):
        survey_can_line(line(lonely, f"can:virtual:doctor{os.getpid()}", denied))
    assert len(wire.receive(0.0)) == 0


@pytest.mark.parametrize("name", ["can7", "any"])
def test_an_interface_with_a_listener_is_not_opened(lonely: HostInspector, tmp_path: Path, name: str) -> None:
    one = line(lonely, "can:socketcan:can7", why(tmp_path))
    plant(lonely.proc / "net/can/rcvlist_all", NOBODY_HEARS)
    plant(lonely.proc / "net/can/rcvlist_fil", HEARD.format("can8"))
    with pytest.raises(OperationFailed) as caught:
        survey_can_line(one)
    assert "listens" not in str(caught.value), "this machine has no can7"
    plant(lonely.proc / "net/can/rcvlist_fil", HEARD.format(name))
    with pytest.raises(OperationFailed, match="can7 was not opened, a program listens there"):
        survey_can_line(one)


def test_a_serial_adapter_opened_by_another_process_is_not_opened(
    lonely: HostInspector, tmp_path: Path
) -> None:
    master, slave = os.openpty()
    try:
        port = os.ttyname(slave)
        (lonely.proc / "4242/fd").mkdir(parents=True)
        (lonely.proc / "4242/fd/3").symlink_to(port)
        with pytest.raises(OperationFailed, match=f"{port} is held by pid 4242"):
            survey_can_line(line(lonely, f"can:slcan:{port}", why(tmp_path)))
    finally:
        os.close(master)
        os.close(slave)
