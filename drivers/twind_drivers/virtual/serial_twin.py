"""Parts of a virtual twin that all families of serial servos share: fault orders, and physics of a bus."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from twind.virtual.fault_commands import REAL, SHARED_FAULTS, FaultArguments
from twind.virtual.joint_actuators import fence
from twind.virtual.virtual_twin import PhysicsRequest, VirtualBusRequest
from twind_drivers.virtual.servo_physics import FirstOrderPhysics, ServoPhysics

B = TypeVar("B")

SERIAL_FAULTS: FaultArguments = {
    **SHARED_FAULTS,
    "silence": {"id?": int, "on?": bool, "number?": int},
    "corrupt": {"count": int, "id?": int, "bits?": int},
    "forge": {"count": int, "id?": int},
    "cut": {"count": int, "bytes": int, "id?": int},
    "noise": {"seconds": REAL, "count?": int, "id?": int},
    "bit_errors": {"rate": REAL, "to_servos?": bool, "to_host?": bool},
    "mangle": {"count": int, "bits?": int, "bytes?": int},
    "babble": {"on?": bool},
    "split": {"bytes": int},
    "latency": {"seconds": REAL, "payload?": int},
    "collide": {"on?": bool},
    "power": {"on": bool},
}


def serial_bus(make: Callable[..., B], request: VirtualBusRequest, baud: int, **more: Any) -> B:
    """Build one bus of serial servos. `make`: its class; `more`: arguments that only this class has."""
    return make(
        request.name,
        request.devices,
        request.physics,
        baud=baud,
        wire_timing=request.line.wire_timing,
        now=request.now,
        adapter=request.line.adapter,
        seed=request.line.seed,
        **more,
    )


def serial_physics(request: PhysicsRequest) -> ServoPhysics:
    """Build the servo physics of one bus: part of a body, or joints without load."""
    if request.body is not None:
        return request.body.part(list(request.places))
    muscles = FirstOrderPhysics(np.array(request.start, np.float64), now=request.now)
    fence(muscles, request.hinges)
    return muscles
