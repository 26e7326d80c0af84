"""The rows in real time, over pseudo-terminals: lines, servos, supply. Processes are in `real_processes`."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from tests.proof.faults.can_real import on_can
from tests.proof.faults.real_processes import PROCESSES
from twind.client import CallError
from twind.command_line.verb import write_register

if TYPE_CHECKING:
    from tests.proof.faults.ground import Ground


TICK = 2.0 * np.pi / 4096  # rad
SEEN = 0.05  # s that it took to be looked at


def _away(ground: Ground, **back: Any) -> None:
    """Unplugged in motion and plugged in again: found, identified, disarmed, unmoved."""
    ground.moving()
    ground.inject({"fault": "unplug", "bus": "main"})
    ground.detected()
    time.sleep(0.3)
    ground.stands()
    ground.torque(True)
    before = ground.places()
    ground.obey({"fault": "replug", "bus": "main", **back})
    ground.running.reach(5.0, hw_connected=True)
    time.sleep(0.3)
    status = ground.running.status()
    ground.claim(not status["armed"], "armed by itself")
    ground.claim(status["state"] == "fault", f"state {status['state']}")
    moved = float(np.abs(ground.places() - before).max())
    ground.claim(moved <= 2.0, f"a joint moved {moved:.1f} ticks when the bus came back")
    ground.recover()


def unplugged(ground: Ground) -> None:
    """Rows 1 and 2: the moment within a tick is as it happens."""
    _away(ground)


def renamed(ground: Ground) -> None:
    """Row 3: another device under the same link."""
    _away(ground, renamed=True)


def harmless(**fault: Any) -> Callable[[Ground], None]:
    """Dropped and told; the motion goes on."""

    def run(ground: Ground) -> None:
        ground.moving(watched=True)
        before = ground.bad()
        ground.inject(dict(fault))
        ground.counted(before)
        ground.goes_on()
        ground.claim(not ground.running.status()["faults"], "a fault is latched")

    return run


def stops(
    but_one: bool = False, heal: tuple[str, ...] = ("clear",), after: float = 0.0, **fault: Any
) -> Callable[[Ground], None]:
    """Told; shafts stand, torque stays; nothing by itself; back by command."""

    def run(ground: Ground) -> None:
        ground.moving(watched=True)
        id = ground.swinging(far=3.0 * after * TICK)  # wherever in its stroke it is held, the goal gets away
        ground.inject(dict(fault) | ({"id": id} if but_one else {}))
        if after:  # the goal must go on before anybody can know
            seen = ground.until(lambda: ground.behind(id) > after, 4.0)
            ground.claim(seen, "the shaft was never behind")
            ground.begun = time.monotonic() - SEEN
        ground.detected(ground.fault.bound + (SEEN if after else 0.0))
        time.sleep(1.0)
        ground.stands()
        for name in heal:
            ground.obey({"fault": name} | ({"id": id} if name in ("free",) else {}))
        ground.recover()

    return run


def burst(ground: Ground) -> None:
    """Row 9: at most a hold, and heard again."""
    ground.moving(watched=True)
    before = ground.bad()
    ground.inject({"fault": "noise", "seconds": float(ground.random.uniform(0.01, 0.04))})
    ground.counted(before)
    if not ground.reported_before(ground.fault.codes):  # a mere warning is not told again within 10 s
        ground.detected()
    time.sleep(0.5)
    ground.claim(not ground.running.status()["faults"], "a fault is latched")
    ground.torque(True)
    ground.recover()


def all_silent(ground: Ground) -> None:
    """Row 11: no power, and power again."""
    ground.moving()
    ground.inject({"fault": "power", "on": False})
    ground.detected()
    time.sleep(1.0)
    ground.claim(bool(ground.running.status()["faults"]), "nothing is latched")
    ground.obey({"fault": "power", "on": True})
    time.sleep(1.5)
    ground.torque(False)
    ground.recover()


def duplicate(ground: Ground) -> None:
    """Row 12: two of one id from the start: nobody is armed."""
    id = int(ground.random.integers(1, 25))
    ground.robot("--servo", f"main:{id}:XM430-W350")
    ground.daemon(wait=False)
    ground.begun = time.monotonic()

    def named() -> bool:
        said = ground.running.log.read_text()
        return any(code in said for code in ground.fault.codes)

    found = ground.until(named, 15.0)
    ground.claim(found, "nothing is said of two servos with one id")
    with ground.client() as client:
        try:
            client.call("AcquireLease")
            client.call("Arm")
            ground.claim(False, "armed with two of one id")
        except CallError:
            pass
    ground.torque(False)


def shutdown(ground: Ground) -> None:
    """Row 14."""
    ground.moving(watched=True)
    id = ground.swinging()
    ground.inject({"fault": "damage", "id": id, "bits": int(ground.random.choice([4, 32]))})
    ground.detected()
    time.sleep(0.8)
    ground.stands(but=[id])
    ground.torque(True, but=[id])
    ground.recover()


def heating(ground: Ground) -> None:
    """Row 15: a ramp past 70 °C: told, lowered, not armed while hot."""
    ground.moving(watched=True)
    id = ground.swinging()
    celsius = 58.0
    while celsius < 75.0:
        if celsius > 60.5 and not ground.begun:
            ground.begun = time.monotonic()
        ground.obey({"fault": "heat", "id": id, "celsius": celsius})
        celsius += 0.6
        time.sleep(0.1)
    ground.detected(2.0)
    ground.lowered(12.0)
    with ground.running.client() as client:
        try:
            client.call("Reset")
            client.call("AcquireLease")
            client.call("Arm")
            ground.claim(False, "armed while hot")
        except CallError:
            pass
    ground.obey({"fault": "heat", "id": id, "celsius": 30.0})
    time.sleep(2.0)
    ground.recover()


def spike(ground: Ground) -> None:
    """Row 16."""
    ground.moving(watched=True)
    ground.inject({"fault": "spike", "id": ground.swinging(), "celsius": 150.0, "seconds": 0.15})
    ground.goes_on(2.0)
    ground.claim(not ground.running.status()["faults"], "a fault is latched")


def sag(ground: Ground) -> None:
    """Row 17: from 12 V to 10.3."""
    ground.moving(watched=True)
    volts = 12.0
    while volts > 10.3:
        if volts < 11.0 and not ground.begun:
            ground.begun = time.monotonic()
        ground.obey({"fault": "supply", "volts": round(volts, 2)})
        volts -= 0.1
        time.sleep(0.05)
    ground.detected()
    ground.lowered(12.0)
    ground.obey({"fault": "supply", "volts": 12.0})
    time.sleep(1.0)
    ground.recover()


def frozen(ground: Ground) -> None:
    """Row 19: the encoder repeats its value; told once its goal has gone on."""
    ground.moving(watched=True)
    id = ground.swinging()

    def goal() -> float:
        return float(next(servo["goal"] for servo in ground.servos() if servo["id"] == id))

    before = goal()
    ground.inject({"fault": "freeze", "id": id})
    ground.until(lambda: abs(goal() - before) > 60.0, 4.0)
    ground.begun = time.monotonic() - 0.25  # it may have been told while that was looked at
    ground.detected(0.25 + 0.25)
    time.sleep(0.8)
    ground.stands()
    ground.obey({"fault": "clear"}, {"fault": "freeze", "id": id, "on": False})
    ground.recover()


def homing_lost(ground: Ground) -> None:
    """Row 20: the homing offset is another one after all: arming is refused."""
    ground.robot()
    ground.daemon()
    client = ground.client()
    client.call("AcquireLease")
    id = ground.swinging()
    before = client.call("ReadRegister", bus="main", id=id, name="homing_offset")["register"]["value"]
    write_register(client, bus="main", id=id, name="homing_offset", value=int(before) + 512)
    time.sleep(1.0)
    try:
        client.call("AcquireLease")
        client.call("Arm")
        ground.claim(False, "armed with another homing offset")
    except CallError as error:
        ground.claim(
            "CALIB_MISMATCH" in str(error) or "OUT_OF_LIMIT" in str(error), f"refused: {error}"[:200]
        )
    ground.torque(False)
    write_register(client, bus="main", id=id, name="homing_offset", value=int(before))
    time.sleep(1.5)
    ground.arm(client)


REAL: dict[int, Callable[[Ground], None]] = {
    1: unplugged,
    2: unplugged,
    3: renamed,
    5: harmless(fault="corrupt", count=2, bits=3),
    6: harmless(fault="forge", count=2),
    7: stops(fault="mangle", count=1_000_000, bits=8),
    8: stops(fault="babble"),
    9: burst,
    10: stops(but_one=True, fault="silence"),
    11: all_silent,
    12: duplicate,
    13: stops(but_one=True, fault="brown_out"),
    14: shutdown,
    15: heating,
    16: spike,
    17: sag,
    18: stops(but_one=True, heal=("free", "clear"), after=130.0, fault="lock"),
    19: frozen,
    20: homing_lost,
    38: on_can,
    **PROCESSES,
}
