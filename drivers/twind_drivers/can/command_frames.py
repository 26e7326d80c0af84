"""Commands to the actuators: goals, holds and softness as frames that have passed the last check.

Stiffness and damping travel with each command, so the source of a goal also sets them. Softness, once
ordered, therefore lasts until strength is restored.
"""

from collections.abc import Mapping
from weakref import ref

import numpy as np

from twind_drivers.bus import Bools, Floats, Ints, WireRangeError, WriteRequest
from twind_drivers.can.actuator_family import ValuelessCommand
from twind_drivers.can.actuator_group import joined
from twind_drivers.can.can_cyclic_read import SoftPoll
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_transaction import PendingCanGoals
from twind_drivers.can.can_units import COUNT, counts
from twind_drivers.can.command_frame_check import CommandFrameCheck
from twind_drivers.can.register_access import ADDRESS, COMMAND, GAINS, whole_command
from twind_drivers.ports.frame import Frames

FIRMER = 2.0  # factor on the damping of a soft actuator, at most its field: undamped it would fall, not sink
# s and cycles, the longer: time of a hold without goals; for ever would feed a dead writer's watchdogs
KEPT = 0.5
CYCLES = 10


class CanCommandEncoder:
    """Encoder of commands to m actuators.

    `lower`, `upper` (m,) in counts; `kp`, `kd` (m,) in N·m/rad and N·m·s/rad.
    """

    def __init__(self, reader: CanReader, lower: Ints, upper: Ints, kp: Floats, kd: Floats) -> None:
        """Make the encoder.

        Raises ValueError for another shape, lower above upper, and gains outside their field.
        """
        self.reader = reader
        self.fleet = reader.fleet
        self.line = reader.line
        self.cyclic = reader.cyclic
        m = len(self.fleet)
        self.kp, self.kd = (np.asarray(each, np.float64) for each in (kp, kd))
        for each in (self.kp, self.kd):
            if each.shape != (m,):
                raise ValueError(f"{reader.name}: {each.shape} values for {m} actuators")
        self._require_gains()
        self.lower, self.upper, self.check = self._bounds(lower, upper)
        self.soft: Bools = np.zeros(m, np.bool_)  # (m,) actuators without stiffness until prepared anew
        self.aim: Ints | None = None  # (m,) last goals to hold, counts
        self._given: Ints | None = None  # (m,) last goals, counts ...
        self._given_in = -1  # ... their cycle, and the goals of the cycle before
        self._before: Ints | None = None
        orders = [
            [self.fleet.encode_valueless_command(row, ValuelessCommand.DISABLE) for row in range(m)]
        ] * 2
        self._off = joined([frame for each in orders for frame in each])
        self.check.judge(self._off)
        self._knock()

    def set_goal_limits(self, lower: Ints, upper: Ints) -> None:
        """Set the range of goals (m,), counts, and drop pending and repeated goals.

        Raises ValueError as `__init__` does; then nothing changes.
        """
        self.lower, self.upper, self.check = self._bounds(lower, upper)
        self.line.goals = self.aim = self._given = self._before = None
        self._knock()

    def _bounds(self, lower: Ints, upper: Ints) -> tuple[Ints, Ints, CommandFrameCheck]:
        least, most = (np.array(each, np.int64) for each in (lower, upper))
        for each in (least, most):
            if each.shape != (len(self.fleet),):
                raise ValueError(f"{self.reader.name}: {each.shape} values for {len(self.fleet)} actuators")
        if not (least <= most).all():
            row = int(np.argmin(least <= most))
            where = f"{self.reader.name}: id {self.reader.ids[row]}"
            raise ValueError(f"{where}: bounds {least[row]}..{most[row]}")
        return least, most, CommandFrameCheck(self.fleet, least, most)

    def _require_gains(self) -> None:
        ranges = self.fleet.ranges
        for name, values, most in (("kp", self.kp, ranges.kp), ("kd", self.kd, ranges.kd)):
            fine = (values >= 0.0) & (values <= most)
            if not fine.all():
                row = int(np.argmin(fine))
                id = self.reader.ids[row]
                value = float(values[row])
                bound = float(most[row])
                raise ValueError(f"{self.reader.name}: id {id}: {name} {value} is outside 0..{bound}")

    def _knock(self) -> None:
        """Prepare a command without stiffness and torque, to poll actuators that answer only commands.

        It causes no motion. It is damped, so that an actuator that was left holding a load lets it sink
        instead of fall.
        """
        rows = (self.fleet.answers == 0) & self.fleet.replies
        if rows.any():
            values = np.zeros((5, len(rows)))
            values[0] = np.clip(0, self.lower, self.upper) * COUNT
            values[3] = self.damping
            frames = self.fleet.command(values, rows)
            self.check.judge(frames)
            self._poll = SoftPoll(frames, rows)
            self.cyclic.knock = ref(self._poll)

    # --------------------------------------------------------------------------- every tick

    def goals(self, ticks: Ints) -> None:
        """Set goals (m,) in counts for the next request. Raises WireRangeError, ValueError.

        After an error nothing is pending. The speed beside them is the step from the goal of the cycle
        before. A step beyond the field's range is a jump, and has no speed. A barred actuator
        (`CanCyclicRead`) is not commanded.
        """
        self.line.goals = None
        self._require(ticks)
        if self._given_in != self.cyclic.cycle:
            self._before = self._given if self._given_in == self.cyclic.cycle - 1 else None
        before = ticks if self._before is None else self._before
        speed: Floats = np.asarray((ticks - before) * COUNT * self.reader.rate_hz, np.float64)
        speed[np.abs(speed) > self.fleet.ranges.velocity] = 0.0
        rows = ~self.cyclic.barred
        frames = self.encode(ticks, speed, rows if self.cyclic.barred.any() else None)
        self._given = ticks.copy()
        self._given_in = self.cyclic.cycle
        self.line.goals = PendingCanGoals(frames, rows, ticks.copy())

    def _require(self, ticks: Ints) -> None:
        if ticks.shape != self.lower.shape:
            raise ValueError(f"{self.reader.name}: {ticks.shape} goals for {len(self.lower)} actuators")
        outside = ~((ticks >= self.lower) & (ticks <= self.upper))
        if outside.any():
            row = int(np.argmax(outside))
            bounds = float(self.lower[row]), float(self.upper[row])
            raise WireRangeError(self.reader.name, self.reader.ids[row], float(ticks[row]), *bounds)

    def encode(self, ticks: Ints, speed: Floats, rows: Bools | None, *, soft: Bools | None = None) -> Frames:
        """Encode frames to `rows` (m,), None: all, and check them; `soft` (m,): those without stiffness.

        Raises WireRangeError.
        """
        frames = self.fleet.command(self._values(ticks, speed, soft=soft), rows)
        self.check.judge(frames)
        return frames

    def _values(self, ticks: Ints, speed: Floats | None = None, *, soft: Bools | None = None) -> Floats:
        """Return position, velocity, kp, kd, torque (5, m) of a command, SI."""
        values = np.zeros((5, len(self.lower)))
        values[0] = ticks * COUNT
        values[2] = self.kp
        values[3] = self.kd
        if speed is not None:
            values[1] = speed
        weak = self.soft if soft is None else self.soft | soft
        if weak.any():
            values[3, weak] = self.damping[weak]
            values[1:3, weak] = 0.0
        return values

    @property
    def damping(self) -> Floats:
        """Damping (m,) of a soft actuator, N·m·s/rad."""
        damping: Floats = np.minimum(FIRMER * self.kd, self.fleet.ranges.kd)
        return damping

    # --------------------------------------------------------------------------- scripts' parts

    def hold(self, ticks: Ints, *, soft: Bools | None = None) -> None:
        """Command `ticks` (m,) in each request until goals come, half a second.

        `soft` (m,): those without stiffness. Raises WireRangeError.
        """
        self._require(ticks)
        rows = ~self.cyclic.barred
        until = self.line.sent + max(KEPT, CYCLES / self.reader.rate_hz)
        still = np.zeros(len(ticks))
        frames = self.encode(ticks, still, rows, soft=soft)
        self.line.goals = PendingCanGoals(frames, rows, ticks.copy(), until=until, kept=True)

    def order(self, ticks: Ints, rows: Bools, *, soft: Bools | None = None) -> WriteRequest:
        """Make the same command as an order to `rows` (m,). Raises WireRangeError."""
        self._require(ticks)
        values = self._values(ticks, soft=soft)
        return WriteRequest(
            {self.reader.ids[row]: whole_command(values[:, row]) for row in _places(rows)}, COMMAND
        )

    def encode_valueless_command(self, what: ValuelessCommand, rows: Bools) -> WriteRequest:
        """Make an order without a value to `rows` (m,)."""
        return WriteRequest({self.reader.ids[row]: b"" for row in _places(rows)}, ADDRESS[what])

    def clear_faults(self, rows: Bools) -> tuple[WriteRequest, ...]:
        """Clear the faults of `rows` (m,), where such an order exists; others stay and are reported."""
        able = rows.copy()
        for row in _places(rows):
            try:
                self.fleet.encode_valueless_command(row, ValuelessCommand.CLEAR)
            except ValueError:
                able[row] = False
        return (self.encode_valueless_command(ValuelessCommand.CLEAR, able),) if able.any() else ()

    def gains(self, rows: Bools) -> WriteRequest:
        """Make the order of gains to those of `rows` (m,) whose commands do not carry them."""
        values = self._values(self.lower)[2:4]
        return WriteRequest(
            {self.reader.ids[row]: whole_command(values[:, row]) for row in _places(rows)}, GAINS
        )

    def here(self) -> Ints:
        """Return the reported positions (m,) as goals: the nearest permitted counts."""
        place = np.where(np.isfinite(self.cyclic.place), self.cyclic.place, 0.0)
        return np.clip(counts(place), self.lower, self.upper)

    def cut(self, rows: Bools | None = None) -> None:
        """Order torque off for all, or for `rows` (m,), twice, in the next send.

        From then on none of them counts as energised; the others do as before.
        """
        self.line.goals = None
        if rows is None:
            self.line.urgent = self._off
            self.cyclic.energised = np.zeros(len(self.lower), np.bool_)
        else:  # a waiting cut of all actuators stays
            own = self._off[rows[self.fleet.commanded_rows(self._off)]]
            self.line.urgent = joined([self.line.urgent, own])
            self.cyclic.energised = self.cyclic.energised & ~rows

    def by_id(self, rows: Bools) -> list[int]:
        """Return the ids of `rows` (m,)."""
        return [self.reader.ids[row] for row in _places(rows)]

    def rows(self, ids: Mapping[int, object]) -> Bools:
        """Return the rows (m,) of those ids."""
        found = np.zeros(len(self.lower), np.bool_)
        found[[self.fleet.row(id) for id in ids]] = True
        return found


def _places(rows: Bools) -> list[int]:
    places: list[int] = np.flatnonzero(rows).tolist()
    return places
