"""Virtual CAN actuators and python-can: over its `virtual` interface, and its slcan over a pty."""

import json
import socket
import threading
from pathlib import Path

import can
import numpy as np
import pytest

from tests.support.python_can_bridge import PythonCanBridge
from twind.virtual.fault_commands import FaultCommandSocket
from twind.virtual.pty_port import VirtualPtyPort
from twind.virtual.virtual_server import ServoClock, VirtualBusServer
from twind_drivers.clock import MonotonicClock
from twind_drivers.virtual.can.can_motor_physics import FirstOrderCanPhysics
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.can.virtual_can_bus import VirtualCanBus

NODES = [NodeSpec(1, "DM4310", 0x11), NodeSpec(3, "ODrive"), NodeSpec(0x7F, "RS01")]
ENABLE = can.Message(arbitration_id=1, data=bytes.fromhex("FFFFFFFFFFFFFFFC"), is_extended_id=False)
ASK = can.Message(arbitration_id=0x1100FD7F, data=bytes.fromhex("0570000000000000"), is_extended_id=True)


def bus_of(now: float = 0.0) -> VirtualCanBus:
    return VirtualCanBus("can", NODES, FirstOrderCanPhysics(np.zeros(3), now=now), now=now)


def received(bus: can.BusABC, timeout: float, most: int = 40) -> list[can.Message]:
    """So many frames at most, or what comes until the line is still for `timeout` s."""
    heard = []
    while len(heard) < most and (message := bus.recv(timeout=timeout)) is not None:
        heard.append(message)
    return heard


def test_python_can_exchanges_frames_over_its_virtual_interface() -> None:
    name = "twind-test-pump"
    with (
        can.Bus(interface="virtual", channel=name) as host,
        can.Bus(interface="virtual", channel=name) as inside,
    ):
        line = bus_of()
        pump = PythonCanBridge(line, inside)
        host.send(ENABLE)
        host.send(ASK)
        host.send(can.Message(arbitration_id=0x074, is_remote_frame=True, is_extended_id=False, dlc=8))
        pump.step(0.0)
        due = pump.step(0.005)
        heard = {each.arbitration_id: each for each in received(host, 0.0)}
        assert heard[0x11].data[0] == 0x11
        assert heard[0x11007FFD].is_extended_id
        assert heard[0x74].dlc == 8
        assert 0.005 < due < 0.02, "the next estimates of the ODrive"
        line.faults.passive()
        pump.step(0.006)
        assert any(each.is_error_frame for each in received(host, 0.0))


class Served:
    """The bus on a pseudo-terminal, served by a thread of this process."""

    def __init__(self, folder: Path) -> None:
        clock = ServoClock(MonotonicClock())
        self.bus = bus_of(clock.now())
        self.port = VirtualPtyPort("can", None)
        self.server = VirtualBusServer({"can": self.bus}, {"can": self.port}, clock, lambda name, path: None)
        self.orders = folder / "orders"
        self.server.orders = FaultCommandSocket(self.orders, self.server.execute_fault_command)
        self._thread = threading.Thread(target=self.server.run)
        self._thread.start()

    def order(self, order: dict) -> dict:
        with socket.socket(socket.AF_UNIX) as talk:
            talk.settimeout(5.0)
            talk.connect(str(self.orders))
            talk.sendall(json.dumps(order).encode() + b"\n")
            return json.loads(talk.recv(65536))

    def close(self) -> None:
        self.server.ended = True
        self._thread.join(5.0)
        self.server.orders.close()
        self.port.close()


@pytest.fixture
def served(tmp_path: Path):
    made = Served(tmp_path)
    yield made
    made.close()


def test_python_can_slcan_exchanges_frames_over_a_pseudo_terminal(served: Served) -> None:
    with can.Bus(
        interface="slcan", channel=served.port.path, bitrate=1_000_000, sleep_after_open=0.05
    ) as host:
        host.send(ENABLE)
        told = next(each for each in received(host, 0.3) if each.arbitration_id == 0x11)
        assert bytes(told.data[:6]).hex() == "117fff7ff7ff"
        host.send(ASK)
        assert any(each.arbitration_id == 0x11007FFD for each in received(host, 0.3))
        state = served.order({"query": "state"})["buses"]["can"]
        assert [each["torque"] for each in state["servos"]] == [True, False, False]
        assert state["kind"] == "can"
        assert served.order({"fault": "silence", "id": 3})["ok"]
        received(host, 0.3, most=1000)
        host.send(ENABLE)
        assert [each.arbitration_id for each in received(host, 0.3)] == [0x11], "the ODrive is silent"
        refused = served.order({"fault": "babble"})
        assert not refused["ok"]
        assert "no fault 'babble'" in refused["error"]
        assert served.order({"fault": "record", "count": 10})["ok"]
        host.send(ENABLE)
        received(host, 0.1)
        recorded = served.order({"query": "history"})
        assert recorded["ids"] == [1, 3, 0x7F]
        assert len(recorded["position"][0]) == 3
