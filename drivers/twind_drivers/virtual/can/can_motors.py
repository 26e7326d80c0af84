"""Motors of the nodes of one bus: the last command of each, given to the physics together.

The physics advances at most once a millisecond. A node's report is at most that old, and a command acts at
most that much early.
"""

import numpy as np

from twind_drivers.virtual.can.can_motor_physics import CanMotorPhysics
from twind_drivers.virtual.shaft_physics import Bools, Floats

REFRESH = 0.001  # s


class CanMotors:
    """m motors, in rows. Lists are (m,), as of the last `settle` or `advance`."""

    def __init__(self, muscles: CanMotorPhysics, limits: list[float], now: float) -> None:
        """Make the motors; `limits` (m,): largest torque of each, N·m."""
        count = len(limits)
        self.muscles = muscles
        self.limits = np.array(limits)
        self.on: Bools = np.zeros(count, np.bool_)
        self._commands: Floats = np.zeros((5, count))  # place, speed, kp, kd, torque
        self._last: list[tuple[float, ...]] = [()] * count  # last command; empty: torque off
        self._held = np.zeros(count, np.bool_)
        # rad, rad/s; NaN: no hand
        self._hand = np.full(count, np.nan)
        self._reach = np.zeros(count)
        self._frozen: dict[int, float] = {}
        self._changed = True
        self.at = now  # s, when the muscles moved last
        self._read()
        self._push()

    def command(self, row: int, place: float, speed: float, kp: float, kd: float, torque: float) -> None:
        """Torque is on, and follows this: rad of the shaft, rad/s, N·m/rad, N·m·s/rad, N·m."""
        values = (place, speed, kp, kd, torque)
        if values != self._last[row]:
            self._last[row] = values
            self.on[row] = True
            self._commands[:, row] = values
            self._changed = True

    def release_torque(self, row: int) -> None:
        """Torque is off."""
        self.on[row] = False
        self._last[row] = ()
        self._commands[:, row] = 0.0
        self._changed = True

    def limit(self, row: int, torque: float) -> None:
        """The most that it may pull, N·m."""
        self.limits[row] = torque
        self._changed = True

    def block(self, row: int, held: bool) -> None:
        """Something holds this shaft fast, or lets it go."""
        self._held[row] = held
        self.muscles.block(self._held)

    def set_hand_position(self, row: int, place: float, speed: float) -> None:
        """Move a shaft by hand to `place` (rad; NaN: release it), rad/s.

        The hand slips where torque is on.
        """
        self._hand[row] = place
        self._reach[row] = speed
        self.muscles.set_hand_positions(self._hand, self._reach)
        self._changed = True

    def freeze(self, row: int, on: bool) -> None:
        """Freeze the reading of its encoder."""
        if on:
            self._frozen[row] = self.position[row]
        else:
            self._frozen.pop(row, None)

    def settle(self, now: float) -> None:
        """The lists are true to a millisecond."""
        if now - self.at >= REFRESH:
            self.advance(now)

    def advance(self, now: float) -> None:
        """Let the time pass until `now`, s."""
        self._push()
        self.at = max(self.at, now)
        self.muscles.advance(now)
        self._read()

    def _push(self) -> None:
        if self._changed:
            self._changed = False
            place, speed, kp, kd, torque = self._commands
            self.muscles.drive(self.on, place, speed, kp, kd, torque, self.limits)

    def _read(self) -> None:
        self.position: list[float] = self.muscles.position.tolist()  # rad of the shaft
        self.velocity: list[float] = self.muscles.velocity.tolist()  # rad/s
        self.torque: list[float] = self.muscles.torque.tolist()  # N·m
        for row, place in self._frozen.items():
            self.position[row] = place
            self.velocity[row] = 0.0
