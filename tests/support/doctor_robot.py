"""A virtual robot with things wrong for the doctor to find, planted by orders and by another client.

Registers are written and read with `dynamixel-sdk`, which shares no code with the doctor's way to a servo.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import dynamixel_sdk as sdk

from tests.support.processes import Daemon, Virtual, until
from twind.client import ClientError
from twind.config.robot_file import load_robot

BAUD = 2_000_000
SIZES = {
    9: 1,
    10: 1,
    11: 1,
    12: 1,
    20: 4,
    38: 2,
    44: 4,
    48: 4,
    52: 4,
    60: 1,
    63: 1,
    64: 1,
    68: 1,
    98: 1,
}

# Where a fault shows: address and size of what is measured (e-manual), and whether it does by now.
SHOWN: dict[str, tuple[int, int, Callable[[int, dict[str, Any]], bool]]] = {
    "heat": (146, 1, lambda celsius, order: celsius == order["celsius"]),
    "sag": (144, 2, lambda decivolts, order: decivolts <= 120 - 10 * order["volts"]),
}


class Vendor:
    """The vendor's client on a port that nobody else has, for as long as the block lasts."""

    def __init__(self, port: str, baud: int = BAUD) -> None:
        self.port = sdk.PortHandler(port)
        self.talk = sdk.PacketHandler(2.0)
        assert self.port.openPort()
        assert self.port.setBaudRate(baud)

    def __enter__(self) -> "Vendor":
        return self

    def __exit__(self, *_: object) -> None:
        self.port.closePort()

    def read(self, id: int, address: int, size: int = 0) -> int:
        """Unsigned, as it lies there."""
        size = size or SIZES[address]
        for _ in range(10):  # on a busy machine an answer may come too late for this client
            data, result, _ = self.talk.readTxRx(self.port, id, address, size)
            if result == sdk.COMM_SUCCESS:
                return int.from_bytes(bytes(data), "little")
        raise AssertionError((id, address, self.talk.getTxRxResult(result)))

    def write(self, id: int, address: int, value: int, size: int = 0) -> None:
        """Write a register and read it back: at status return level 1 no servo replies to a write."""
        size = size or SIZES[address]
        data = list(value.to_bytes(size, "little"))
        self.talk.writeTxRx(self.port, id, address, size, data)
        assert self.read(id, address, size) == value, (id, address, value)

    def reboot(self, id: int) -> None:
        """And wait until it is back."""
        self.talk.reboot(self.port, id)
        for _ in range(50):
            if self.talk.ping(self.port, id)[1] == sdk.COMM_SUCCESS:
                return
        raise AssertionError(f"id {id} does not come back")


@dataclass
class Ground:
    """One virtual robot, and how it is reached."""

    virtual: Virtual
    before: dict[tuple[int, int], int] = field(default_factory=dict)  # registers as they were

    @property
    def port(self) -> str:
        """Port of its only serial bus."""
        return next(iter(self.virtual.ports.values()))

    def set(self, vendor: Vendor, id: int, address: int, value: int) -> None:
        """Write a register, remembering what was there."""
        self.before.setdefault((id, address), vendor.read(id, address))
        vendor.write(id, address, value)

    def restore(self, vendor: Vendor) -> None:
        """Every register as it was; the last one that was written first."""
        for id in {id for id, _ in self.before}:  # torque locks EEPROM; one comes up with it by itself
            if vendor.read(id, 64):
                vendor.write(id, 64, 0)
        for id, address in reversed(self.before):
            value = self.before[id, address]
            if vendor.read(id, address) != value:
                vendor.write(id, address, value)
        self.before.clear()


@dataclass(frozen=True)
class Case:
    """Something wrong with one servo: planted, found, undone."""

    code: str
    id: int
    registers: tuple[tuple[int, int], ...] = ()  # address, value
    order: tuple[tuple[str, Any], ...] = ()  # of a fault
    heal: tuple[tuple[str, Any], ...] = ()  # the order that takes it back; () with an order: a restart
    told: str = ""  # what the finding must name
    mended: tuple[int, int] | None = None  # address, value after `--fix`
    times: int = 1  # how often it is found


def case(
    code: str, id: int, *registers: tuple[int, int], text: str = "", mended: Any = None, times: int = 1
) -> Case:
    """Registers of one servo."""
    return Case(code, id, registers, told=text, mended=mended, times=times)


def fault(
    code: str, id: int, order: dict[str, Any], heal: dict[str, Any] | None = None, text: str = ""
) -> Case:
    """An order of a fault."""
    return Case(code, id, (), tuple(order.items()), tuple((heal or {}).items()), text)


@contextmanager
def planted(ground: Ground, cases: tuple[Case, ...]) -> Iterator[None]:
    """All of them wrong for as long as the block lasts, also where it fails."""
    with Vendor(ground.port) as vendor:
        plant(ground, vendor, cases)
    try:
        yield
    finally:
        with Vendor(ground.port) as vendor:
            heal(ground, vendor, cases)


def ready(running: Daemon, key: str = "torque", but: str = "") -> None:
    """Wait until `key` of every joint is told: with such servos the daemon never calls itself connected."""

    def read() -> bool:
        with suppress(ClientError), running.client() as client:
            joints = client.call("GetStatus", joints=True)["joints"]
            unknown = False if key == "heard" else None
            return all(each[key] is not unknown for each in joints if each["name"] != but)
        return False

    until(read, 60.0, f"the {key} of everybody is told")


def plant(ground: Ground, vendor: Vendor, cases: tuple[Case, ...]) -> None:
    """All of them at once."""
    for each in cases:
        for address, value in each.registers:
            if address == 98:  # the watchdog that is written runs out while nobody feeds it
                ground.before[each.id, 98] = 0
                vendor.talk.writeTxRx(vendor.port, each.id, 98, 1, [value])
            else:
                ground.set(vendor, each.id, address, value)
        if each.order:
            ground.virtual.order(**dict(each.order))
    for order in (dict(each.order) for each in cases):
        if order.get("fault") in SHOWN:  # what is measured follows a moment later
            register, size, lasts = SHOWN[order["fault"]]
            until(lambda: lasts(vendor.read(order["id"], register, size), order), 5.0, f"{order} shows")  # noqa: B023
    watched = {each.id for each in cases if {64, 98} <= {address for address, _ in each.registers}}
    until(lambda: watched <= tripped(ground), 5.0, "watchdogs that nobody feeds run out")


def tripped(ground: Ground) -> set[int]:
    """Ids whose watchdog has run out."""
    return {servo["id"] for servo in ground.virtual.servos() if servo["watchdog"] == 255}


def heal(ground: Ground, vendor: Vendor, cases: tuple[Case, ...]) -> None:
    """All of it undone: orders taken back, servos with a hardware error restarted, registers written back."""
    for each in cases:
        if each.heal:
            ground.virtual.order(**dict(each.heal))
        elif each.order:
            vendor.reboot(each.id)
    ground.restore(vendor)


def upper_body(folder: Path) -> Path:
    """The upper half of h24 on one bus: twelve servos; one is in mode 5, one has a register asked for."""
    built_in = load_robot("h24").path
    head, _, below = built_in.read_text().partition("  # left leg\n")
    below, _, _ = below.partition("\nlegs:")
    passive = [line.split(":")[0].strip() for line in below.splitlines() if "{id:" in line]
    head = head.replace("name: h24\n", "name: doctored\n").replace(
        "h24.xml", str(built_in.parent / "h24.xml")
    )
    head = head.replace("{id: 10,", "{id: 10, registers: {velocity_limit: 200},")
    head = head.replace("{id: 12,", "{id: 12, mode: current_based_position,")
    rest = "collision: {block_m: 0.002, warn_m: 0.010, allow: []}\nposes: {rest: {}}\nmotions: motions\n"
    file = folder / "doctored.yaml"
    file.write_text(f"{head}\npassive: [{', '.join(passive)}]\nlegs: []\n{rest}")
    load_robot(str(file))
    return file
