"""The bus monitor of servos with packets of the first protocol: each wrong packet breaks its rule."""

from collections.abc import Iterable

import pytest

from tests.proof.busmon.limits import Limits, Servo
from tests.proof.busmon.protocol1.protocol1_monitor import Protocol1Monitor
from tests.proof.busmon.protocol1.protocol1_packets import STS

PERIOD = 0.01
HERE = 2048


def packet(id: int, code: int, *params: int) -> bytes:
    body = bytes((id, len(params) + 2, code, *params))
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def word(value: int) -> tuple[int, int]:
    return value & 0xFF, value >> 8


def write(address: int, *rows: tuple[int, Iterable[int]]) -> bytes:
    data = [(id, *values) for id, values in rows]
    return packet(254, 0x83, address, len(data[0]) - 1, *(each for row in data for each in row))


class Port:
    """A bus with servos 1 and 2 as a daemon would use it."""

    def __init__(self, *, writes: bool = True) -> None:
        servos = {
            id: Servo(id, f"j{id}", 3, 1000, 3000, 2000.0, 10_000.0, 0, 4096, HERE, (990, 3010), 300.0, 0)
            for id in (1, 2)
        }
        limits = Limits("main", PERIOD, 1_000_000, "fixed", servos, STS)
        self.monitor = Protocol1Monitor(limits, writes=writes)
        self.now = 1.0
        self.monitor.take_report("state", self.now, state="arming")
        self.read()

    def send(self, data: bytes) -> None:
        self.now += PERIOD
        self.monitor.sent(data, self.now)

    def read(self, place: int = HERE, torque: int = 0) -> None:
        """Positions of both, and torque."""
        self.send(packet(254, 0x82, 56, 2, 1, 2))
        self.monitor.answered(b"".join(packet(id, 0, *word(place)) for id in (1, 2)), self.now + 0.001)
        self.send(packet(254, 0x82, 40, 1, 1, 2))
        self.monitor.answered(b"".join(packet(id, 0, torque) for id in (1, 2)), self.now + 0.001)

    def goals(self, value: int, *more: int) -> None:
        self.send(write(42, *((id, word(value)) for id in (1, 2, *more))))

    def arm(self) -> None:
        self.goals(HERE)
        self.send(write(40, (1, (1,)), (2, (1,))))
        self.read(torque=1)
        self.monitor.take_report("state", self.now, state="armed")

    @property
    def rules(self) -> list[str]:
        return sorted({each.rule for each in self.monitor.violations})


def test_an_arming_and_a_motion_in_small_steps_break_no_rule() -> None:
    port = Port()
    port.arm()
    for step in range(20):
        port.goals(HERE + 15 * step)
        port.read(HERE + 15 * step, 1)
    port.send(packet(254, 0x03, 40, 0))
    assert port.rules == []
    assert port.monitor.goal_packets == 21
    assert not port.monitor.servos.on.any()


def armed() -> Port:
    port = Port()
    port.arm()
    return port


WRONG = {
    "goal beyond the range": ("W1", lambda port: [port.goals(each) for each in range(HERE, 3030, 15)]),
    "EEPROM while armed": ("W2", lambda port: port.send(write(9, (1, word(100))))),
    "midpoint by torque enable": ("W2", lambda port: port.send(write(40, (1, (128,))))),
    "operating mode": ("W2", lambda port: port.send(packet(1, 0x03, 33, 1))),
    "half a goal": ("W2", lambda port: port.send(packet(1, 0x03, 42, 1))),
    "factory reset": ("W8", lambda port: port.send(packet(1, 0x06))),
    "foreign id": ("W2", lambda port: port.goals(HERE, 3)),
    "step too large": ("W3", lambda port: (port.goals(HERE), port.goals(HERE + 40))),
    "wrong checksum": ("W8", lambda port: port.send(packet(1, 1)[:-1] + b"\0")),
    "a packet after a kill": (
        "W11",
        lambda port: (port.monitor.take_report("killed", port.now), port.goals(HERE)),
    ),
    "a goal in a state without goals": (
        "W5",
        lambda port: (
            port.monitor.take_report("state", port.now, state="connected"),
            port.goals(HERE),
        ),
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_packet_breaks_its_rule(name: str) -> None:
    rule, act = WRONG[name]
    port = armed()
    act(port)
    assert port.rules == [rule], [str(each) for each in port.monitor.violations]


def test_torque_on_without_a_goal_breaks_the_rule_of_the_first_goal() -> None:
    port = Port()
    port.send(write(40, (1, (1,))))
    assert port.rules == ["W4"]


def test_torque_on_away_from_the_goal_breaks_the_rule_of_the_first_goal() -> None:
    port = Port()
    port.goals(HERE)
    for _ in range(10):
        port.read(HERE + 50)
    port.send(write(40, (1, (1,))))
    assert port.rules == ["W4"]


def test_a_goal_to_a_servo_whose_torque_reads_off_breaks_a_rule() -> None:
    port = armed()
    port.send(packet(254, 0x03, 40, 0))
    port.goals(HERE)
    assert "W4" in port.rules


def test_a_mirror_that_writes_breaks_a_rule() -> None:
    port = Port(writes=False)
    port.goals(HERE)
    assert port.rules == ["W10"]


def test_silence_while_armed_asks_for_a_hold() -> None:
    port = armed()
    port.now += 0.1
    for step in range(1, 120):
        port.goals(HERE + step % 20)
    assert port.rules == ["W7"]
