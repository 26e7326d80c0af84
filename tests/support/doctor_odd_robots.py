"""Robots that are odd by themselves: strangers on a bus, legs with faults, a servo of protocol 1.0."""

import os
import pty
import select
import struct
import subprocess
import sys
import threading
import tty
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can

from tests.support.doctor_robot import BAUD
from tests.support.processes import Virtual, until
from twind.config.robot_file import load_robot


class Loose(Virtual):
    """Servos as from the factory, but for their rate, on a bus `main`: nobody made them for a robot."""

    def __init__(self, folder: Path, robot: str, servos: Iterable[str]) -> None:
        self.folder = folder
        self.robot = robot
        self.calibration = folder / "none.yaml"
        command = [
            sys.executable,
            "-m",
            "twind.virtual",
            "--baud",
            str(BAUD),
            "--faults",
            str(folder / "faults"),
        ]
        command += [word for each in servos for word in ("--servo", f"main:{each}")]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self.process.stdout is not None
        said = [self.process.stdout.readline().decode().split() for _ in range(2)]
        assert [word for word, *_ in said] == ["bus", "ready"], said
        self.ports = {said[0][1]: said[0][2]}


class Wrench:
    """Raw frames by python-can on a slcan port that nobody else has: another client than the doctor's."""

    def __init__(self, port: str) -> None:
        self.bus = can.Bus(interface="slcan", channel=port, bitrate=1_000_000, sleep_after_open=0.1)

    def __enter__(self) -> "Wrench":
        return self

    def __exit__(self, *_: object) -> None:
        self.bus.shutdown()

    def register(self, id: int, register: int, value: bytes) -> None:
        """One register of a Damiao, 4 bytes, in RAM; its acknowledgement says that it was taken."""
        self.bus.send(_frame(0x7FF, bytes((id, 0, 0x55, register)) + value))
        assert (heard := self.bus.recv(1.0)) is not None
        assert bytes(heard.data[4:]) == value, heard

    def torque(self, id: int, *, on: bool) -> None:
        """Enable or disable."""
        self.bus.send(_frame(id, b"\xff" * 7 + (b"\xfc" if on else b"\xfd")))
        assert self.bus.recv(1.0) is not None


def _frame(id: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=id, data=data, is_extended_id=False)


def started(virtual: Virtual, bus: str) -> bool:
    """All of a bus have power, and have had it for long enough to answer."""
    return all(node["listening"] for node in virtual.order(query="state")["buses"][bus]["servos"])


@contextmanager
def wrong_legs(virtual: Virtual) -> Iterator[None]:
    """All that `LEGS` says, for as long as the block lasts."""
    with Wrench(virtual.ports["l_leg"]) as wrench:
        wrench.register(1, 21, struct.pack("<f", 25.0))
        wrench.register(2, 10, bytes((3, 0, 0, 0)))
        wrench.torque(4, on=True)
    virtual.order(fault="damage", bus="l_leg", id=3, bits=10)
    virtual.order(fault="silence", bus="l_leg", id=5)
    virtual.order(fault="supply", bus="r_leg", volts=19.0)
    try:
        yield
    finally:
        virtual.order(fault="clear", bus="l_leg")
        virtual.order(fault="supply", bus="r_leg", volts=48.0)
        virtual.order(fault="power", bus="l_leg", on=False)  # what was not stored is forgotten
        virtual.order(fault="power", bus="l_leg", on=True)
        until(lambda: started(virtual, "l_leg"), 5.0, "what has power again has started")


def legs(folder: Path) -> Path:
    """h24-mixed; what is left of its right leg tells its voltage, and nobody reads its watchdogs back."""
    built_in = load_robot("h24-mixed").path
    text = built_in.read_text().replace("name: h24-mixed\n", "name: legs\n")
    text = text.replace("h24.xml", str(built_in.parent / "h24.xml"))
    lost = ("r_hip_pitch", "r_knee", "r_ankle_pitch", "r_ankle_roll")
    lines = [line for line in text.splitlines() if line.split(":")[0].strip() not in lost]
    text, _, _ = "\n".join(lines).partition("\nlegs:")
    text += f"\npassive: [{', '.join(lost)}]\nlegs: []\nposes: {{rest: {{}}}}\n"
    text = text.replace("type: dm4310, bus: r_leg", "type: rs02, bus: r_leg")
    kind = (
        *("device: RS02", "gains: {kp: 200.0, kd: 3.0}", "torque_limit_nm: 7.0", "velocity_limit_rad_s: 4.0"),
        *("acceleration_limit_rad_s2: 20.0", "supply: {warn_v: 20.0, settle_v: 18.0, fault_v: 16.0}"),
        *("heat: {warn_c: 80, slow_c: 85, settle_c: 90, cool_c: 70}", "watchdog: unverified"),
    )
    file = folder / "legs.yaml"
    file.write_text(text.replace("\ndefaults:", f"  rs02: {{{', '.join(kind)}}}\n\ndefaults:"))
    return file


@contextmanager
def old_servo(id: int = 7) -> Iterator[str]:
    """The path of a port on which one servo answers protocol 1.0 pings, and nothing else."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    stop = threading.Event()

    def serve() -> None:
        heard = b""
        while not stop.is_set():
            if select.select([ours], [], [], 0.02)[0]:
                heard += os.read(ours, 4096)
                if heard.endswith(bytes((0xFF, 0xFF, 0xFE, 0x02, 0x01, 0xFE))):
                    os.write(ours, bytes((0xFF, 0xFF, id, 0x02, 0x00, ~(id + 2) & 0xFF)))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        stop.set()
        thread.join()
        os.close(theirs)
        os.close(ours)
