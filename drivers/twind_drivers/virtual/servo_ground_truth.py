"""True state of virtual servos, independent of the bus, for tests that check the host's view of them."""

import math
from typing import Any

from twind_drivers.virtual.virtual_servos import VirtualServos


def truth(servos: VirtualServos, now: float) -> list[dict[str, Any]]:
    """Return one dict per servo, in rows, as of `now` (s, the servos' own clock).

    position and goal in the register's frame (position unrounded); encoder in continuous ticks; velocity raw;
    torque, watchdog register, tripped. heard_ago: s since the last packet that it received; tripped_at: s of
    the last trip; trip_delay: s from the packet before it; None: never.
    """
    position = servos.muscles.position * servos.direction + servos.shift
    return [
        {
            "id": servos.registers.id_of(row),
            "position": float(position[row]),
            "encoder": float(servos.muscles.position[row]),
            "velocity": float(servos.muscles.velocity[row]),
            "goal": int(servos["goal_position"][row]),
            "torque": bool(servos["torque_enable"][row]),
            "watchdog": int(servos["bus_watchdog"][row]),
            "tripped": bool(servos.tripped[row]),
            "listening": bool(servos.listening[row]),
            "heard_ago": now - float(servos.heard_at[row]),
            "tripped_at": _number(servos.tripped_at[row]),
            "trip_delay": _number(servos.trip_delay[row]),
        }
        for row in range(len(servos.tripped))
    ]


def _number(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
