"""Setpoints of a jog for as long as its control is held. They end with the hold, and with this process."""

import time
from collections.abc import Callable

from twind.robot_client.goal_stream import GoalStream
from twind.robot_client.jog_motion import JogMotion

PERIOD = 0.02  # s between setpoints
VALID = 0.1  # s that one may be followed without the next, counted from when it was made
ANSWER = 2.0  # s for each answer of the daemon while a control is held

Steer = Callable[[JogMotion, float], bool]


def follow_while_held(stream: GoalStream, motion: JogMotion, steer: Steer) -> None:
    """Send the setpoints of `motion` until `steer` returns False.

    `steer` is called every `PERIOD` with the motion, which it may direct, and the time (s, monotonic). The
    caller then sends `Cancel`. Raises ClientError: a setpoint was refused or not answered.
    """
    stream.valid_for = VALID
    stream.expires = True
    last = time.monotonic()
    with stream:
        while steer(motion, now := time.monotonic()):
            positions, velocities = motion.advance(now - last)
            stream.send(positions, velocities)
            last = now
            time.sleep(max(0.0, now + PERIOD - time.monotonic()))
