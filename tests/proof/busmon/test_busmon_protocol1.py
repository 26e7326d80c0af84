"""The bus monitor of servos with packets of the first protocol: each wrong packet breaks its rule."""

from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from tests.proof.busmon import protocol1
from tests.proof.busmon.limits import Limits, Servo
from tests.proof.busmon.protocol1.protocol1_monitor import Protocol1Monitor
from tests.proof.busmon.protocol1.protocol1_packets import STS
from tests.proof.evil.accusations import Accusation, accusations, without

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

    def __init__(self, *, writes: bool = True, monitor: type[Protocol1Monitor] = Protocol1Monitor) -> None:
        servos = {
            id: Servo(id, f"j{id}", 3, 1000, 3000, 2000.0, 10_000.0, 0, 4096, HERE, (990, 3010), 300.0, 0)
            for id in (1, 2)
        }
        limits = Limits("main", PERIOD, 1_000_000, "fixed", servos, STS)
        self.monitor = monitor(limits, writes=writes)
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


def armed(port: Port) -> Port:
    port.arm()
    return port


def state(port: Port, name: str) -> None:
    port.monitor.take_report("state", port.now, state=name)


def let_go(port: Port) -> None:
    port.send(packet(254, 0x03, 40, 0))


def read_away(port: Port) -> None:
    port.goals(HERE)
    for _ in range(10):
        port.read(HERE + 50)


# What a wrong daemon does, on an armed port or on one that is being armed, and the rule that it breaks.
WRONG: dict[str, tuple[str, Callable[[Port], object]]] = {
    "goal beyond the range": ("W1", lambda p: (armed(p), [p.goals(each) for each in range(HERE, 3030, 15)])),
    "EEPROM while armed": ("W2", lambda p: armed(p).send(write(9, (1, word(100))))),
    "EEPROM under torque": (
        "W2",
        lambda p: (armed(p), state(p, "calibrating"), p.send(packet(1, 3, 13, 60))),
    ),
    "midpoint by torque enable": ("W2", lambda p: armed(p).send(write(40, (1, (128,))))),
    "half a goal": ("W2", lambda p: armed(p).send(packet(1, 0x03, 42, 1))),
    "write to a foreign id": ("W2", lambda p: armed(p).goals(HERE, 3)),
    "read of a foreign id": ("W2", lambda p: armed(p).send(packet(9, 0x02, 56, 2))),
    "bulk read": ("W2", lambda p: armed(p).send(packet(254, 0x92, 0, 2, 1, 56))),
    "restart while armed": ("W2", lambda p: armed(p).send(packet(1, 0x08))),
    "restart of torque that nobody read": (
        "W2",
        lambda p: (p.arm(), state(p, "connected"), p.send(packet(1, 8))),
    ),
    "torque with an open lock": ("W2", lambda p: (p.send(packet(1, 0x03, 55, 0)), p.arm())),
    "factory reset": ("W8", lambda p: armed(p).send(packet(1, 0x06))),
    "step too large": ("W3", lambda p: (armed(p).goals(HERE), p.goals(HERE + 40))),
    "first goal elsewhere": ("W4", lambda p: armed(p).goals(HERE + 40)),
    "wrong checksum": ("W8", lambda p: armed(p).send(packet(1, 1)[:-1] + b"\0")),
    "torque without a goal": ("W4", lambda p: p.send(write(40, (1, (1,))))),
    "torque away from the goal": ("W4", lambda p: (read_away(p), p.send(write(40, (1, (1,)))))),
    "goal to a limp servo": ("W4", lambda p: (let_go(armed(p)), p.goals(HERE))),
    "a second talker": ("W9", lambda p: armed(p).monitor.take_report("talker", p.now)),
    "packet after a kill": ("W11", lambda p: (armed(p).monitor.take_report("killed", p.now), p.goals(HERE))),
    "goal in a state without goals": ("W5", lambda p: (armed(p), state(p, "connected"), p.goals(HERE))),
}


def rules_of(name: str, monitor: type[Protocol1Monitor] = Protocol1Monitor) -> set[str]:
    """Rules that a wrong daemon breaks by a monitor."""
    port = Port(monitor=monitor)
    WRONG[name][1](port)
    return set(port.rules)


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_packet_breaks_its_rule(name: str) -> None:
    assert rules_of(name) == {WRONG[name][0]}


@pytest.mark.parametrize("place", accusations(Path(protocol1.__file__).parent), ids=str)
def test_without_any_one_accusation_a_wrong_packet_passes(place: Accusation) -> None:
    silent = without(Protocol1Monitor, place)
    assert any(rules_of(name, silent) != {rule} for name, (rule, _) in WRONG.items()), place.text


@pytest.mark.parametrize(("pause", "off", "rules"), [(1, 0, ["W6"]), (12, 0, []), (12, 3, ["W3", "W6"])])
def test_after_a_silence_an_e_stop_may_aim_a_servo_where_it_is_read_and_nowhere_else(
    pause: int, off: int, rules: list[str]
) -> None:
    """Back from a goal that leads the shaft is no step for a servo that has counted as stopped since."""
    port = armed(Port())
    for step in range(10):
        port.goals(HERE + 15 * step)
    port.goals(HERE + 15 * 9)
    for _ in range(pause):
        port.read(HERE + 60, 1)
    port.monitor.take_report("estop", port.now, level="settle")
    state(port, "estop")
    port.goals(HERE + 60 + off)
    assert port.rules == rules


def test_a_mirror_that_writes_breaks_a_rule() -> None:
    port = Port(writes=False)
    port.goals(HERE)
    assert port.rules == ["W10"]


def test_silence_while_armed_asks_for_a_hold() -> None:
    port = armed(Port())
    port.now += 0.1
    for step in range(1, 120):
        port.goals(HERE + step % 20)
    assert port.rules == ["W7"]
