"""Real-time tests of can socketcan."""

import subprocess
import sys
from collections.abc import Iterator

import pytest
from can.interfaces.socketcan import socketcan

from tests.support.python_can_channel_rig import NOWHERE, Wire, opened
from twind.doctor.host_inspector import HostInspector
from twind_drivers.bus import PortError
from twind_drivers.ports.can_interface_lock import owners


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Iterator[Wire]:
    wire = Wire()
    monkeypatch.setattr(socketcan, "create_socket", wire.socket)
    yield wire
    for each in wire.sockets:
        each.close()


def test_an_owner_that_is_killed_owns_nothing_any_more(wire: Wire) -> None:
    program = (
        "from twind_drivers.ports.can_interface_lock import CanInterfaceLock; sign = "
        f"CanInterfaceLock({NOWHERE!r}); print(flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "\n"
        assert list(owners(NOWHERE)) == [other.pid]
        assert [each.pid for each in HostInspector().owners(NOWHERE)] == [other.pid]
        with pytest.raises(PortError, match=f"in use by pid {other.pid} "):
            opened()
        other.kill()
    opened().close()


APART = """
import ctypes, os, sys
if ctypes.CDLL(None, use_errno=True).unshare(0x10000000 | 0x40000000):  # a user and a network of its own
    print("denied"); sys.exit()
from twind_drivers.ports.can_interface_control import restart
import fcntl, socket
from twind_drivers.ports.can_interface_control import FLAGS, REQUEST
def up():
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        return REQUEST.unpack(fcntl.ioctl(asking, FLAGS, REQUEST.pack(b"lo", 0)))[1] & 1
before = up(); said = restart("lo"); print(before, repr(said), up(), repr(restart("none")))
"""


def test_an_interface_goes_down_and_up_where_it_is_permitted() -> None:
    """In a network of its own: `lo` starts there down."""
    import subprocess
    import sys

    done = subprocess.run([sys.executable, "-c", APART], capture_output=True, text=True, check=True)
    if done.stdout.strip() == "denied":
        pytest.skip("no network of our own to be had here")
    before, said, after, *rest = done.stdout.split(" ", 3)
    assert (before, said, after) == ("0", "''", "1")
    assert "No such device" in rest[0]
