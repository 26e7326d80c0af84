"""Shaft of one node in its own frame, its torque, and the watchdog that ends it."""

import math
from math import inf

from twind_drivers.virtual.can.can_motors import CanMotors

TURN = 2.0 * math.pi


class NodeShaft:
    """Shaft of a node. Its reported position is that of the bare encoder less its `zero`, rad."""

    def __init__(self, row: int, motors: CanMotors) -> None:
        self.row = row
        self.motors = motors
        self.zero = 0.0  # rad of the encoder at reading 0
        self.kept_zero = 0.0  # rad of it that remain without power
        self.goal = 0.0  # rad, as commanded
        self.on = False
        self.turns_due = 0  # turns that its place jumps by at the next `wrap`

    def enable(self) -> None:
        """Switch torque on; until the first command it pulls with 0 N·m."""
        self.wrap()
        self.on = True
        self.motors.command(self.row, 0.0, 0.0, 0.0, 0.0, 0.0)

    def disable(self) -> None:
        """Torque off."""
        self.on = False
        self.motors.release_torque(self.row)

    def wrap(self) -> None:
        """The turns that are due come now: it has restarted in between."""
        self.zero -= self.turns_due * TURN
        self.turns_due = 0

    def wrap_position(self) -> None:
        """Wrap the position to -pi..pi: the count of turns is lost."""
        place = self.motors.position[self.row] - self.kept_zero
        self.zero = self.kept_zero + TURN * math.floor(place / TURN + 0.5)

    def set_zero(self) -> None:
        """Set the zero to the present position."""
        self.zero = self.kept_zero = self.motors.position[self.row]

    def read_state(self) -> tuple[float, float, float]:
        """Place rad, speed rad/s, torque N·m, before a field cuts them."""
        row = self.row
        motors = self.motors
        return motors.position[row] - self.zero, motors.velocity[row], motors.torque[row]

    def follow(self, place: float, speed: float, kp: float, kd: float, torque: float) -> None:
        """A command in its own frame; without torque only remembered."""
        self.goal = place
        if self.on:
            self.motors.command(self.row, place + self.zero, speed, kp, kd, torque)


class NodeWatchdog:
    """The watchdog of one node, by its own clock. Times are s."""

    def __init__(self, now: float) -> None:
        self.timeout = inf  # s without a frame to it; inf: none
        self.heard_at = now
        self.tripped = False
        self.tripped_at = math.nan
        self.trip_delay = math.nan

    def expiry(self, on: bool) -> float:
        """Return the time (s) of expiry; only with torque, and once."""
        return self.heard_at + self.timeout if on and not self.tripped else inf

    def trip(self, now: float) -> None:
        """Record the expiry."""
        self.tripped = True
        self.tripped_at = now
        self.trip_delay = now - self.heard_at
