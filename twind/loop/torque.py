"""The torque itself: who may be taken over, ours from now on, or off and read back off.

Torque off that somebody did not confirm is not forgotten: it is ordered again when they answer.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

import numpy as np

from twind.loop.procedures import Procedure, all_of
from twind.robot.finding import ReasonCode
from twind.safety.guard import GuardThresholds
from twind_drivers.bus import BusError, NoReply

if TYPE_CHECKING:
    from twind.loop.tick import Loop
    from twind.robot.arrays import Bools, Floats

INSIST = 1.0  # s that torque off is repeated to those who do not confirm it
EDGE = (
    GuardThresholds().beyond_hard
)  # rad beyond a hard limit that are the encoder's, not the joint's (OUT_OF_LIMIT)


def beyond_hard_limit(loop: Loop) -> Bools:
    """Joints (n,) measured beyond a hard limit: no goal may be where they are, and one inside is a step.
    None of them is who is nowhere (NaN)."""
    position = loop.measured.position
    limits = loop.limits
    return (position < limits.hard_lower - EDGE) | (position > limits.hard_upper + EDGE)


def joint_names(loop: Loop, which: Bools) -> str:
    """Joints of the mask (n,) by name; of many the first ones."""
    names = [loop.joints.names[joint] for joint in np.flatnonzero(which).tolist()]
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more


def error_text(loop: Loop, error: Exception) -> str:
    """What the bus said, and whose devices did not answer by their joints' names."""
    which = np.zeros(len(loop.joints), np.bool_)
    if isinstance(error, NoReply):
        for bus in loop.joints.buses:
            if bus.name == error.port:
                which[bus.joints[np.isin(bus.ids, error.ids)]] = True
    return f"{error} ({joint_names(loop, which)})" if which.any() else str(error)


def say_unconfirmed(loop: Loop, error: BusError) -> None:
    """Torque off that somebody did not confirm."""
    said = f"torque could not be read back off: {error_text(loop, error)}"
    loop.say.event("error", ReasonCode.TORQUE_MISMATCH, said)


def take(loop: Loop, held: Floats) -> None:
    """From here on the goals (n,) are ours: every bus holds at `held`, which was written and read back."""
    loop.armed = True
    loop.energising = False
    loop.owed = False
    loop.unconfirmed = False
    loop.hardware.hold(True)
    loop.executor.begin(held)
    loop.written = held


def switch_torque_off(loop: Loop) -> Procedure:
    """Torque off, read back. Raises BusError naming who did not confirm it: see `again`."""
    loop.executor.idle()
    loop.hardware.clear()
    loop.hardware.hold(False)
    for writer in loop.hardware.writers:
        writer.cut()  # twice, with the next packet of any kind
    loop.hardware.quiet_until = -inf  # torque off waits for nobody's watchdog
    # not known to be off until it is read back
    loop.armed = False
    loop.energising = True
    loop.soft_since = None
    loop.unconfirmed = True
    until = loop.clock.now() + INSIST
    while True:
        try:
            yield from all_of(loop.hardware.torque(False))
        except BusError:
            if loop.clock.now() < until and loop.hardware.writers:
                yield
                continue
            loop.energising = False  # who is still on stands in the registers, and is reported as inherited
            raise
        loop.energising = loop.unconfirmed = False
        return


def retry_torque_off(loop: Loop) -> Procedure:
    """Somebody who did not confirm torque off is heard again, with torque on: off."""
    loop.say.event(
        "warning", ReasonCode.TORQUE_MISMATCH, "torque was ordered off and is still on: off once more"
    )
    try:
        yield from switch_torque_off(loop)
    except BusError as error:
        say_unconfirmed(loop, error)
