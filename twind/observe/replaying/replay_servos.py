"""Servos with the registers of a recording, and the present writes on top.

`twind_drivers.virtual` has the protocol; this module has only the values.
"""

from collections.abc import Sequence
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from twind.exceptions import OperationFailed
from twind.observe.replaying import device_state_tracker as told
from twind.observe.replaying.device_state_tracker import BusTimeline, DeviceEvent
from twind_drivers.virtual.servo_physics import FirstOrderPhysics, ServoPhysics
from twind_drivers.virtual.virtual_servos import BAUDS, TRIPPED, ServoSpec, VirtualServos

Bools = NDArray[np.bool_]
CLOCK = 32768  # ms: the realtime tick (120) counts up to this
LEAD = 3.0  # s: a daemon is connected and armed by then
SOON = 2.0  # s after the beginning by which everything was read once
AHEAD = 0.002  # s: what was read so little later was true already


class ReplayPosition:
    """Position of the replay in the recording: its beginning until the start, afterwards as time goes.

    Shared by all buses and by the clients. Only the clocks of the servos run before the beginning.
    """

    def __init__(self, begin: float, lead: float = LEAD) -> None:
        """`begin`: s, of the recording; `lead`: s from the first question to it."""
        self.begin = begin
        self._lead = lead
        self.ready = False
        self._first = inf  # s, now: the first question
        self.shift = inf  # s, now less the time of the recording; inf: not let go yet

    @property
    def running(self) -> bool:
        """It was let go."""
        return self.shift < inf

    def due(self, now: float) -> bool:
        """Check that the replay may start: the clients are ready, and the planned time has come."""
        self._first = min(self._first, now)
        return self.ready and now >= self._first + self._lead

    def go(self, now: float, moment: float) -> None:
        """Let it go: now is that moment of the recording."""
        self.shift = now - moment

    def moment(self, now: float) -> float:
        """s, of the recording."""
        return now - self.shift if self.running else self.begin

    def clock(self, now: float) -> float:
        """The same for what runs before it, so that clocks do not jump where it is let go as planned."""
        return now - self.shift if self.running else self.begin - (min(self._first, now) + self._lead - now)


class ReplayServos(VirtualServos):
    """Servos without muscles, heat and watchdogs of their own: what happens to them happened once."""

    _own: Bools | None = None  # (m, size) bytes that no host writes; None: not built yet

    def __init__(
        self,
        specs: Sequence[ServoSpec],
        muscles: ServoPhysics,
        *,
        now: float = 0.0,
        keep_goal: bool = True,
        story: BusTimeline,
        recording: ReplayPosition,
        armed: bool,
    ) -> None:
        """`armed`: in the recording the robot has torque at the beginning, and is given it anew."""
        super().__init__(specs, muscles, now=now, keep_goal=keep_goal)
        # next of them
        self._passage = recording
        self._turns = story.turns()
        self._at = 0
        self._rows = {spec.id: row for row, spec in enumerate(specs)}
        size = self.memory.raw.shape[1]
        self._own = own = np.ones((len(specs), size), np.bool_)
        for row, each in enumerate(self.memory.tables):
            own[row, list(each.writable)] = False
        clocks = [each.fields.get("realtime_tick") for each in self.memory.tables]
        self._clock_at = [-1 if each is None else each.address for each in clocks]
        self._ticks = np.full(len(specs), np.nan)  # s, of the recording: when each servo's clock was 0
        self.silenced[:] = True  # until the first reply
        self._foresee(recording.begin)
        while self._at < len(self._turns) and self._turns[self._at].time <= recording.begin:
            self._begin_with(self._turns[self._at])
            self._at += 1
        if armed:
            for key in ("torque_enable", "bus_watchdog"):
                self.registers.put(key, 0)
        for row in range(len(specs)):
            self.memory.remap(row)
            self.power.reframe(row, one_turn=False)
        self.invalidate_cache()

    def advance(self, now: float) -> None:
        """Apply the events of the recording up to `now`."""
        self.run_timers(now)
        self.now = max(self.now, now)

    def run_timers(self, now: float) -> None:
        """The same; a boot that was ordered now ends by itself, but no watchdog trips but those that did."""
        self.heard_at.fill(now)
        self._event = self._next()
        super().run_timers(now)
        moment = self._passage.moment(now) + AHEAD
        while self._at < len(self._turns) and self._turns[self._at].time <= moment:
            self._happen(self._turns[self._at])
            self._at += 1

    def settle(self, now: float, *, whole: bool = True) -> None:
        """The clocks as of `now`; all else is brought up to it by `expire`."""
        self.run_timers(now)
        up = (self._passage.clock(now) - self._ticks) * 1e3
        for row, at in enumerate(self._clock_at):
            if at >= 0 and isfinite(up[row]):
                self._put(row, at, (int(up[row]) % CLOCK).to_bytes(2, "little"))

    def _boot(self, row: int, now: float) -> None:
        """Keep the last read measurements over a boot."""
        kept = None if self._own is None else self.memory.raw[row].copy()
        super()._boot(row, now)
        if kept is not None and self._own is not None:
            self.memory.raw[row][self._own[row]] = kept[self._own[row]]
            self.registers.put("hardware_error_status", 0, row)

    def _check(self, now: float) -> None:
        """No heat and no load but those that were."""
        self._check_at = inf

    def _foresee(self, begin: float) -> None:
        """Set values that were not read by the beginning to those read first; EEPROM however late."""
        known = np.zeros_like(self.memory.raw, np.bool_)
        kept = max(each.end for made in self.memory.tables for each in made.fields.values() if each.eeprom)
        for turn in self._turns:
            if turn.what == told.READ and (turn.time <= begin + SOON or turn.address < kept):
                row = self._rows[turn.id]
                span = slice(turn.address, turn.address + len(turn.data))
                fresh = (self._owned(row, span) | (np.arange(span.start, span.stop) < kept)) & ~known[
                    row, span
                ]
                self.memory.raw[row, span][fresh] = np.frombuffer(turn.data, np.uint8)[fresh]
                known[row, span] = True
                if not isfinite(self._ticks[row]):
                    self._keep_clock(row, turn)

    def _begin_with(self, turn: DeviceEvent) -> None:
        """Before the beginning, take every recorded value, whoever wrote it."""
        row = self._rows[turn.id]
        if turn.what in (told.SILENT, told.HEARD):
            self.silenced[row] = turn.what == told.SILENT
        elif turn.what in (told.READ, told.CHANGED):
            self._put(row, turn.address, turn.data)
            self._keep_clock(row, turn)

    def _happen(self, turn: DeviceEvent) -> None:
        row = self._rows[turn.id]
        match turn.what:
            case told.SILENT | told.HEARD:
                self.silenced[row] = turn.what == told.SILENT
                self.invalidate_cache()
            case told.READ:
                self._read(row, turn)
            case told.CHANGED:
                self._put(row, turn.address, turn.data)
                self.tripped[row] = self["bus_watchdog"][row] & 0xFF == TRIPPED
                self.invalidate_cache()
            case told.DAMAGED:
                self.inject_error(row, turn.data[0])

    def _put(self, row: int, address: int, data: bytes) -> None:
        self.memory.raw[row, address : address + len(data)] = np.frombuffer(data, np.uint8)

    def _read(self, row: int, turn: DeviceEvent) -> None:
        """Set registers that no host writes to their recorded values."""
        span = slice(turn.address, turn.address + len(turn.data))
        fault = self["hardware_error_status"][row]
        own = self._owned(row, span)
        self.memory.raw[row, span][own] = np.frombuffer(turn.data, np.uint8)[own]
        self._keep_clock(row, turn)
        if self["hardware_error_status"][row] != fault:
            self.invalidate_cache()

    def _keep_clock(self, row: int, turn: DeviceEvent) -> None:
        at = self._clock_at[row] - turn.address
        if self._clock_at[row] >= 0 and 0 <= at <= len(turn.data) - 2:
            self._ticks[row] = turn.time - int.from_bytes(turn.data[at : at + 2], "little") * 1e-3

    def holds(self, id: int, address: int, data: bytes) -> bool:
        """Do the registers that a host writes hold what `data` has? Those of the servo alone may differ."""
        if address < 0 or id not in self._rows:  # no reply, or no servo
            return True
        row = self._rows[id]
        span = slice(address, address + len(data))
        same = self.memory.raw[row, span] == np.frombuffer(data, np.uint8)
        return bool((same | self._owned(row, span)).all())

    def _owned(self, row: int, span: slice) -> Bools:
        assert self._own is not None
        return self._own[row, span]


def specs(story: BusTimeline, baud: int) -> list[ServoSpec]:
    """Servos of the recording by id; `baud` where their own register was not read.

    Raises OperationFailed: a model that has no table, or no servo at all.
    """
    if not story.tables:
        raise OperationFailed(f"bus {story.name}: no device on it reported its model")
    settings = {"baud_rate": BAUDS.index(baud)} if baud in BAUDS else {}
    return [
        ServoSpec(id, made.model, settings, firmware=story.models[id][1])
        for id, made in sorted(story.tables.items())
    ]


def still(count: int) -> ServoPhysics:
    """Physics of `count` servos that are never sampled."""
    return FirstOrderPhysics(np.zeros(count))
