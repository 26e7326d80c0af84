"""Mean positions before, during and after one commanded move."""

from collections.abc import Mapping

import numpy as np

from tests.support.mujoco_servo_rig import WAY
from twind.robot.arrays import Floats
from twind_calibration.wiggling.state_trace import HoldMean, MoveHolds

FRICTION = 0.1  # N·m


def stays_of(moved: Mapping[int, float], twin: float = WAY, *, off: float = 0.0, count: int = 3) -> MoveHolds:
    """Joint 0 was sent WAY."""

    def stay(position: Floats, simulated: Floats) -> HoldMean:
        return HoldMean(position, simulated, np.zeros(count))

    nothing, out, simulated, home = (np.zeros(count) for _ in range(4))
    out[list(moved)] = list(moved.values())
    simulated[0] = twin
    home[0] = off
    return MoveHolds(stay(nothing, nothing), stay(out, simulated), stay(home, nothing))
