"""Every fault that can be ordered: how strong, how long, how it is healed, and what the daemon makes of it.

Orders as the socket of `twind-virtual` takes them, so that a run in process and one over ptys order the same.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from numpy.random import Generator

Order = dict[str, Any]
IDS = 24  # h24: 1..24
STALE = "STATE_STALE"
BUS = "BUS_ERRORS"
FOREIGN = "FOREIGN_TRAFFIC"
GONE = ("TORQUE_MISMATCH", "SERVO_REBOOTED", "SERVO_ALERT", STALE)
ARMED = "armed"
FAULT = "fault"
EITHER = "either"


@dataclass(frozen=True)
class Case:
    """One way of ordering one fault while the robot is armed and moves.

    `alarm`: one of these is told, at the latest `within` s after the order. `ends`: with the torque still on
    and nothing latched, latched, or as it happens.
    """

    make: Callable[[Generator], Order]  # all but the name of the fault
    lasts: tuple[float, float]  # s
    ends: str = ARMED
    alarm: Sequence[str] = ()
    within: float = 0.0
    heal: Callable[[Order], Sequence[Order]] = lambda order: ()  # before `clear`


def one(random: Generator) -> int:
    """An id."""
    return int(random.integers(1, IDS + 1))


def back_on(name: str) -> Callable[[Order], Sequence[Order]]:
    """The same fault with `on` false."""
    return lambda order: [{"fault": name, "on": False} | ({"id": order["id"]} if "id" in order else {})]


def _for_ever(**more: Any) -> Callable[[Generator], Order]:
    return lambda random: {"count": 1_000_000, **more}


def _plain(**arguments: Any) -> Callable[[Generator], Order]:
    return lambda random: dict(arguments)


def _of_answers(**more: Any) -> Sequence[Case]:
    """An answer that is lost now and then costs nothing; one that never comes is a silent servo."""
    silent = {"ends": FAULT, "alarm": (STALE, BUS), "within": 0.06}
    return [
        Case(lambda random: {"count": int(random.integers(1, 4)), **more}, (0.02, 0.1)),
        Case(lambda random: {"count": int(random.integers(2, 5)), "id": one(random), **more}, (0.05, 0.1)),
        Case(lambda random: {"count": 1_000_000, "id": one(random), **more}, (0.55, 0.6), **silent),
        Case(_for_ever(**more), (0.55, 0.6), **silent),
    ]


def _silence() -> Sequence[Case]:
    pulled = {"ends": FAULT, "alarm": (STALE, BUS), "within": 0.06, "heal": back_on("silence")}
    return [
        Case(lambda random: {"id": one(random)}, (0.01, 0.05), heal=back_on("silence")),
        Case(lambda random: {"id": one(random)}, (0.2, 0.3), **pulled),  # its watchdog trips meanwhile
        Case(lambda random: {"id": one(random)}, (0.55, 0.6), **pulled),
        Case(_plain(), (0.55, 0.6), **pulled),
    ]


def _supply() -> Sequence[Case]:
    def normal(order: Order) -> Sequence[Order]:
        return [{"fault": "supply", "volts": 12.0}]

    return [
        Case(lambda random: {"volts": float(random.uniform(11.2, 13.0))}, (0.3, 0.5), heal=normal),
        Case(_plain(volts=9.0), (0.3, 0.5), FAULT, ("SERVO_ALERT",), 0.15, normal),  # limit: 9.5 V
        Case(_plain(volts=2.0), (0.3, 0.5), FAULT, GONE, 0.25, normal),  # dark
    ]


def _sag() -> Sequence[Case]:
    def mended(order: Order) -> Sequence[Order]:
        return [order | {"volts": 0.0}]

    return [
        Case(lambda r: {"id": one(r), "volts": float(r.uniform(0.1, 0.5))}, (0.3, 0.5), heal=mended),
        Case(lambda r: {"id": one(r), "volts": 3.0}, (0.3, 0.5), FAULT, ("SERVO_ALERT",), 0.15, mended),
    ]


def _heat() -> Sequence[Case]:
    def cool(order: Order) -> Sequence[Order]:
        return [{"fault": "heat", "id": order["id"], "celsius": 25.0}]

    return [
        Case(lambda r: {"id": one(r), "celsius": float(r.uniform(30.0, 55.0))}, (0.3, 0.5), heal=cool),
        Case(lambda r: {"id": one(r), "celsius": 90.0}, (0.3, 0.5), FAULT, ("SERVO_ALERT",), 0.15, cool),
    ]


def _power(order: Order) -> Sequence[Order]:
    return [{"fault": "power", "on": True}]


def _plug(**how: Any) -> Case:
    return Case(
        _plain(), (0.05, 0.4), FAULT, ("PORT_LOST",), 0.05, lambda order: [{"fault": "replug", **how}]
    )


CASES: Mapping[str, Sequence[Case]] = {
    "drop": _of_answers(),
    "corrupt": [*_of_answers(), _of_answers(bits=5)[-1]],
    "cut": [*_of_answers(bytes=9), _of_answers(bytes=0)[-2]],
    "foreign": [
        Case(_plain(count=2), (0.1, 0.2)),
        Case(_for_ever(), (0.3, 0.5), FAULT, (FOREIGN,), 0.05),
    ],
    # One or two packets of nobody are no stranger yet; more of them are.
    "forge": [
        Case(lambda random: {"count": int(random.integers(1, 3)), "id": one(random)}, (0.05, 0.1)),
        Case(_for_ever(), (0.55, 0.6), FAULT, (FOREIGN, BUS, STALE), 0.06),
    ],
    "duplicate": [
        Case(_plain(count=1), (0.1, 0.2)),
        # A second answer of who missed one within a second may be that one: foreign then only after it.
        Case(_for_ever(), (0.3, 0.5), FAULT, (FOREIGN, BUS, STALE), 0.06),
    ],
    "noise": [
        Case(lambda random: {"seconds": float(random.uniform(0.001, 0.04))}, (0.05, 0.1)),
        Case(lambda random: {"seconds": 0.0005, "count": 2, "id": one(random)}, (0.05, 0.1)),
        Case(_plain(seconds=1.0), (0.55, 0.6), FAULT, (STALE, BUS), 0.06),
    ],
    "delay": [
        Case(lambda random: {"seconds": float(random.uniform(0.0001, 0.001))}, (0.1, 0.3)),
        Case(lambda r: {"seconds": float(r.uniform(0.004, 0.08)), "id": one(r)}, (0.3, 0.8), EITHER),
        Case(lambda r: {"seconds": 0.01 * float(r.integers(1, 6)), "id": one(r)}, (0.3, 0.8), EITHER),
        Case(lambda random: {"seconds": float(random.uniform(0.004, 0.08))}, (0.3, 0.6), EITHER),
        Case(lambda random: {"seconds": 0.01 * float(random.integers(1, 6))}, (0.3, 0.6), EITHER),
    ],
    "bit_errors": [
        Case(_plain(rate=1e-6), (0.3, 0.5)),
        Case(lambda random: {"rate": float(10 ** random.uniform(-5.0, -2.0))}, (0.2, 0.6), EITHER),
        Case(_plain(rate=0.01, to_host=False), (0.2, 0.4), EITHER),
    ],
    "mangle": [
        Case(lambda random: {"count": int(random.integers(1, 3))}, (0.05, 0.1)),
        Case(_plain(count=10, bits=16, bytes=130), (0.1, 0.2)),  # ten goals that nobody takes
        Case(_plain(count=1_000_000, bits=16), (0.55, 0.6), FAULT, (STALE, BUS), 0.06),
    ],
    "babble": [
        Case(_plain(), (0.005, 0.04)),
        Case(_plain(), (0.55, 0.6), FAULT, (STALE, BUS, FOREIGN), 0.06, back_on("babble")),
    ],
    "split": [Case(lambda random: {"bytes": int(random.integers(1, 64))}, (0.1, 0.3))],
    "latency": [
        Case(lambda random: {"seconds": 0.001, "payload": int(random.choice([62, 510]))}, (0.1, 0.3)),
        Case(_plain(seconds=0.016), (0.1, 0.3), EITHER),
        Case(_plain(seconds=0.016, payload=510), (0.55, 0.6), EITHER, (STALE, BUS), 0.06),
    ],
    "echo": [Case(_plain(), (0.2, 0.3), heal=back_on("echo"))],
    "collide": [Case(_plain(), (0.2, 0.3), heal=back_on("collide"))],
    "garble": [Case(_plain(), (0.2, 0.3), heal=back_on("garble"))],  # nobody is set to another rate
    "stall": [
        Case(_plain(), (0.01, 0.02), EITHER, heal=back_on("stall")),
        Case(_plain(), (0.55, 0.6), FAULT, ("TX_BACKLOG", STALE, BUS), 0.06, back_on("stall")),
    ],
    "silence": _silence(),
    # A hand slips where torque is on.
    "hand": [
        Case(
            lambda random: {"id": one(random), "to": int(random.integers(500, 3500))},
            (0.2, 0.5),
            heal=lambda order: [{"fault": "hand", "id": order["id"], "off": True}],
        )
    ],
    "damage": [
        Case(lambda random: {"id": one(random), "bits": 4}, (0.1, 0.2), FAULT, ("SERVO_ALERT",), 0.03),
        Case(lambda random: {"id": one(random), "bits": 1}, (0.1, 0.2), FAULT, ("SERVO_ALERT",), 0.03),
    ],
    "brown_out": [Case(lambda random: {"id": one(random)}, (0.3, 0.5), FAULT, GONE, 0.25)],
    "power": [
        Case(_plain(on=False), (0.05, 0.1), FAULT, GONE, 0.3, _power),
        Case(_plain(on=False), (0.55, 0.6), FAULT, GONE, 0.3, _power),
    ],
    "supply": _supply(),
    "sag": _sag(),
    "heat": _heat(),
    "spike": [Case(lambda r: {"id": one(r), "celsius": 120.0, "seconds": 0.15}, (0.3, 0.5))],
    # A held shaft and an encoder that repeats its value: the readings are what the registers say.
    "lock": [
        Case(lambda r: {"id": one(r)}, (0.3, 0.5), EITHER, heal=lambda order: [order | {"fault": "free"}])
    ],
    "freeze": [Case(lambda random: {"id": one(random)}, (0.3, 0.5), EITHER, heal=back_on("freeze"))],
    "unplug": [_plug(), _plug(renamed=True)],
    # What heals, and what is no fault, alone.
    "free": [Case(lambda random: {"id": one(random)}, (0.05, 0.1))],
    "replug": [Case(_plain(), (0.05, 0.1))],
    "clear": [Case(_plain(), (0.05, 0.1))],
    "seed": [Case(lambda random: {"number": int(random.integers(1000))}, (0.05, 0.1))],
    "record": [Case(_plain(count=100), (0.05, 0.1))],
}


def order(name: str, case: Case, random: Generator) -> Order:
    """The order, with its fault."""
    return {"fault": name, **case.make(random)}


def healing(case: Case, given: Order) -> list[Order]:
    """Orders that end this fault and all others."""
    return [*case.heal(given), {"fault": "clear"}]
