"""Writer of a bus of XL-320 or PRO -R: goals, torque, registers. Exists in live only.

These servos have no watchdog: they hold their last goal when their master dies. EEPROM is writable without
torque only. After a shutdown a restart is the sure way back.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from twind_drivers.bus import (
    Bools,
    DeviceRefused,
    Ints,
    RebootRequest,
    Script,
    WireRangeError,
)
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.command_packet_check import written_rows
from twind_drivers.dynamixel.device_layout import RegisterBlock
from twind_drivers.dynamixel.goal_packets import GoalPacket
from twind_drivers.dynamixel.replies import StatusReply
from twind_drivers.dynamixel2_unwatched.unwatched_identification import derived, objections
from twind_drivers.dynamixel2_unwatched.unwatched_reader import UnwatchedReader
from twind_drivers.flags import some
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction
from twind_drivers.half_duplex.register_table import MappedRegister
from twind_drivers.half_duplex.register_write_check import RegisterWriteCheck
from twind_drivers.half_duplex.register_writer import SHARE, RegisterWriter, Row
from twind_drivers.half_duplex.soft_gain import soft_gain

PREPARED = "it is set by preparing for torque"
OTHER_MODE = "other modes than position are not driven"
ELSEWHERE = {
    "torque_enable": "torque is switched by arming and disarming",
    "goal_position": "goals pass the gate",
    "goal_torque": PREPARED,
    "goal_velocity": PREPARED,
    "goal_acceleration": PREPARED,
    "moving_speed": PREPARED,
    "control_mode": OTHER_MODE,
    "id": "it would answer under another id than this bus has",
    "baud_rate": "it would answer at another baud rate than this bus has",
    "status_return_level": "below 2 it would confirm no write",
}
FULL = 1023  # of `torque_limit` of the robot file: all


class ChosenGoals:
    """Goals of m devices within `lower`..`upper`, of which some get one. `goal`: the goal register."""

    def __init__(self, name: str, ids: Sequence[int], goal: RegisterBlock, lower: Ints, upper: Ints) -> None:
        self.lower = lower
        self.upper = upper
        self._name = name
        self._ids = tuple(ids)
        self._goal = goal
        self.choose(np.zeros(len(self._ids), np.bool_))

    def choose(self, among: Bools) -> None:
        """Send goals to these devices (m,) alone: none goes to one without torque."""
        rows = np.flatnonzero(among)
        self.places = rows.tolist()
        own = [self._ids[place] for place in self.places]
        bounds = (self.lower[rows], self.upper[rows])
        self._packet = GoalPacket(self._name, own, self._goal, *bounds) if own else None

    def check(self, ticks: Ints) -> None:
        """Raise WireRangeError for the first goal (m,) out of range, ValueError for another shape."""
        if ticks.shape != (len(self._ids),) or ticks.dtype.kind != "i":
            raise ValueError(f"{self._name}: {len(self._ids)} whole ticks needed, got {ticks!r}")
        outside = (ticks < self.lower) | (ticks > self.upper)
        if some(outside):
            place = int(outside.argmax())
            bounds = (int(self.lower[place]), int(self.upper[place]))
            raise WireRangeError(self._name, self._ids[place], int(ticks[place]), *bounds)

    def encode(self, ticks: Ints) -> bytes:
        """Return the packet of goals (m,); empty: no device gets any. Raises as `check`."""
        self.check(ticks)
        return b"" if self._packet is None else self._packet.encode(ticks[self.places])


class Protocol2WriteCheck(RegisterWriteCheck):
    """Permitted writes of one bus with Protocol 2.0."""

    def judge(self, data: bytes) -> None:
        """Raise WireRangeError for anything but whole packets with permitted writes."""
        framer = packet.Framer(status=False)
        found = framer.feed(data)
        if framer.discarded or len(framer) or not found:
            raise WireRangeError(self._name, packet.BROADCAST, len(data), 0, 0, "stray bytes in a packet")
        for each in found:
            if packet.instruction(each.id, each.instruction, each.params) != self._off:
                for id, address, raw in written_rows(each):
                    self._row(id, address, raw)


class UnwatchedWriter(RegisterWriter):
    """Writer to the bus of `reader`. Arrays are (m,), in the order of its ids; goals in counts."""

    ELSEWHERE = ELSEWHERE

    def __init__(
        self,
        reader: UnwatchedReader,
        *,
        lower: Ints,
        upper: Ints,
        gains: Sequence[Mapping[str, int]] = (),
        torque_limits: Sequence[int] = (),
    ) -> None:
        """Make the writer; `lower`, `upper` (m,): counts that may be sent.

        `gains` (m): wanted content of gain registers, by name; others stay as the servo has them.
        `torque_limits` (m): of 1023, of what its EEPROM permits; none: all.
        """
        self._reader = reader
        self._layout = reader.layout
        goal = reader.layout.table["goal_position"]
        self.GOAL = (goal.address, goal.size)
        self.TORQUE = reader.layout.table["torque_enable"].address
        self.LIMIT = reader.layout.limit
        self._wanted = dict(zip(reader.ids, gains, strict=False))
        self._share = dict(zip(reader.ids, torque_limits, strict=False))
        super().__init__(reader, lower=lower, upper=upper)

    def _make_goals(self, least: Ints, most: Ints) -> ChosenGoals:
        return ChosenGoals(self._name, self._ids, RegisterBlock(*self.GOAL), least, most)

    def _make_check(self, bounds: Mapping[int, tuple[int, int]]) -> Protocol2WriteCheck:
        return Protocol2WriteCheck(self._name, self._bus.tables, bounds, self._off())

    def _prepare(self, ids: Sequence[int], ticks: Ints) -> Script[set[int]]:
        state = yield from self._settings(ids)
        # One with torque limit 0 has no torque, whatever its switch reads; 0 of a PRO -R means no limit.
        holding = {
            id
            for id in ids
            if state[id]["torque_enable"] and (state[id][self.LIMIT] or self.LIMIT == "goal_torque")
        }
        rows: list[Row] = []
        for id in ids:
            found = state[id]
            self._full[id] = max(1, found[self._layout.most] * self._share.get(id, FULL) // FULL)
            own = {name: found[name] for name in self._layout.gains}
            rows += self._gain_rows(id, own, self._wanted.get(id, {}))
            if id not in holding:
                rows.append((id, self.LIMIT, max(1, int(self._full[id] * SHARE))))
            rows += [(id, name, 0) for name in self._layout.profile]  # no limit: the executor shapes
            if id in holding:
                rows.append(self._goal_row(id, ticks))
        # One that has torque and torque limit 0 would start at full stiffness towards an old goal.
        yield from self._set([(id, "torque_enable", 0) for id in ids if id not in holding])
        yield from self._set(rows)
        return holding

    def _settings(self, ids: Sequence[int]) -> Script[dict[int, dict[str, int]]]:
        """Read all settings. Raises DeviceRefused for what must not get torque."""
        state: dict[int, dict[str, int]] = {id: {} for id in ids}
        for block in self._layout.settings:
            for id, values in (yield from self._bus.values(ids, *block)).items():
                state[id].update(values)
        for id, found in state.items():
            reasons = objections(self._reader.kind, found["model_number"], derived(found))
            if reasons:
                raise DeviceRefused(self._name, id, "arming", "; ".join(reasons))
        return state

    def _soft_gains(self, id: int) -> list[Row]:
        p, *others = self._layout.gains
        rows = [(id, p, soft_gain(self._gains[id][p]))]
        return rows + [(id, name, 0) for name in others if name == "position_i_gain"]

    def _write_kept(self, id: int, field: MappedRegister, value: int) -> Script[None]:
        self._check.unlocked = id
        try:
            yield from self._write(id, field, value)
        finally:
            self._check.unlocked = None

    def _restart(self, order: RebootRequest) -> SerialTransaction:
        return SerialTransaction(packet.reboot(order.id), StatusReply((order.id,), 0), 1)
