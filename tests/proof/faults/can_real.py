"""Row 38 over pseudo-terminals: a leg on slcan, the independent monitor between daemon and adapter."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from tests.proof.faults.ground import Ground

LEG = "l_leg"
SWING = {"head_yaw": 0.6, "l_knee": 0.5, "l_hip_pitch": -0.4, "r_knee": 0.4}
COUNTS = 4.0  # of 16384 a turn


def _leg(ground: Ground) -> list[dict[str, Any]]:
    """State of the actuators of the leg."""
    found: list[dict[str, Any]] = ground.virtual.order(query="state")["buses"][LEG]["servos"]
    return found


def _others(ground: Ground) -> list[bool]:
    """Devices with torque on the other buses."""
    buses = ground.virtual.order(query="state")["buses"]
    return [bool(servo["torque"]) for name, bus in buses.items() if name != LEG for servo in bus["servos"]]


def _moving(ground: Ground) -> None:
    ground.swing = SWING
    ground.relay_bus = LEG
    ground.moving(name="h24-mixed", watched=True)


def _gone(
    fault: str, *codes: str, heal: str = "", after: float = 1.0, **given: Any
) -> Callable[[Ground], None]:
    """The leg is given up in time and lets go by itself; the others hold; what is back is moved by nobody."""

    def run(ground: Ground) -> None:
        _moving(ground)
        ground.inject({"fault": fault, "bus": LEG} | ({"on": given["on"]} if "on" in given else {}))
        ground.detected(codes=codes)
        time.sleep(0.6)
        ground.claim(not any(node["torque"] for node in _leg(ground)), "the leg keeps its torque")
        ground.claim(all(_others(ground)), "somebody else lost torque")
        time.sleep(float(ground.random.uniform(0.1, after)))
        before = np.array([node["position"] for node in _leg(ground)])
        ground.obey({"fault": heal or fault, "bus": LEG} | ({} if heal else {"on": not given["on"]}))
        ground.running.reach(6.0, hw_connected=True)
        time.sleep(0.5)
        status = ground.running.status()
        ground.claim(status["state"] == "fault", f"state {status['state']}")
        moved = float(np.abs(np.array([node["position"] for node in _leg(ground)]) - before).max())
        ground.claim(moved <= COUNTS, f"an actuator moved {moved:.1f} counts when its bus came back")
        ground.claim(not any(node["torque"] for node in _leg(ground)), "the leg has torque by itself")
        ground.recover()

    return run


def _missing(ground: Ground) -> None:
    """One node is silent: everybody holds, then a fault."""
    _moving(ground)
    id = int(ground.random.integers(1, 7))
    ground.inject({"fault": "silence", "bus": LEG, "id": id})
    ground.detected(codes=("STATE_STALE", "BUS_ERRORS"))
    ground.until(lambda: bool(ground.running.status()["faults"]), 1.0)
    ground.claim(bool(ground.running.status()["faults"]), "nothing is latched")
    ground.claim(all(_others(ground)), "somebody else lost torque")
    ground.obey({"fault": "silence", "bus": LEG, "id": id, "on": False})
    time.sleep(0.5)
    ground.recover()


KINDS: tuple[Callable[[Ground], None], ...] = (
    _gone("power", "CAN_BUS_STATE", on=False),
    _gone("bus_off", "CAN_BUS_STATE", on=True),
    _gone("unacknowledged", "CAN_BUS_STATE", on=True),
    _gone("silence", "CAN_BUS_STATE", on=True),
    _gone("unplug", "PORT_LOST", heal="replug"),
    _missing,
)


def on_can(ground: Ground) -> None:
    """One kind after the other by the seed."""
    KINDS[ground.outcome.seed % len(KINDS)](ground)
