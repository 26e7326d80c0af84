"""Writer of a Feetech bus: what a Feetech servo needs beside the shared part. Exists in live only.

A Feetech servo has no watchdog: it holds its last goal when its master dies. Its errors do not latch, a write
of a bad value is ignored without a word, and EPROM can be written under torque. So every write is read back,
settings are checked before torque, and EPROM is written with torque off: unlock, write, read back, lock.
"""

from collections.abc import Mapping, Sequence

from twind_drivers.bus import DeviceRefused, Ints, RebootRequest, Script
from twind_drivers.feetech.feetech_identification import BLOCKS, objections
from twind_drivers.feetech.feetech_packet import FeetechInstruction
from twind_drivers.feetech.feetech_reader import FeetechReader
from twind_drivers.feetech.feetech_registers import GOAL, map_of_firmware
from twind_drivers.half_duplex import checksum_packet as packet
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction
from twind_drivers.half_duplex.register_table import MappedRegister
from twind_drivers.half_duplex.register_write_check import RegisterWriteCheck
from twind_drivers.half_duplex.register_writer import RegisterWriter, Row
from twind_drivers.half_duplex.soft_gain import soft_gain

# Registers that `write` refuses, with the reason: other paths own them, or the device would be lost.
ELSEWHERE = {
    "torque_enable": "torque is switched by arming and disarming",
    "goal_position": "goals pass the gate",
    "goal_velocity": "it is set by preparing for torque",
    "goal_time": "it is set by preparing for torque",
    "goal_torque": "it is set by preparing for torque",
    "lock": "it is opened and closed around each write to EPROM",
    "operating_mode": "modes other than position are not driven",
    "id": "it would answer under another id than this bus has",
    "baud_rate": "it would answer at another baud rate than this bus has",
    "status_return_level": "at 0 it would confirm no write",
}
SOFT_START = 300  # torque limit (0.1 %) at torque on; then it rises
TORQUE = 40  # address of the torque switch
SHADOWED = (21, 22, 23)  # gains: while the lock is on, a write changes the RAM copy alone
SPEED = {
    "sts": 6000,
    "smbl": 6000,
    "hls": 120,
    "scs": 0,
}  # goal velocity: faster than any servo; SCS: 0 is so
GAINS = ("position_p_gain", "position_d_gain", "position_i_gain")  # registers 21, 22, 23


class FeetechWriter(RegisterWriter):
    """Writer to the bus of `reader`. Arrays are (m,), in the order of its ids; goals in counts."""

    GOAL = GOAL
    TORQUE = TORQUE
    ELSEWHERE = ELSEWHERE

    def __init__(
        self,
        reader: FeetechReader,
        *,
        lower: Ints,
        upper: Ints,
        gains: Sequence[tuple[int | None, int | None, int | None]] | None = None,
        torque_limits: Sequence[int | None] | None = None,
    ) -> None:
        """Make the writer; `lower`, `upper` (m,): counts that may be sent.

        `gains` (m): P, I, D each; None: as the servo has it. `torque_limits` (m): 0.1 %; None: register 16.
        Raises ValueError for bounds of the wrong shape or beyond the goal register.
        """
        self._reader = reader
        self._wanted_gains = dict(zip(reader.ids, gains or (), strict=False))
        self._wanted_limits = dict(zip(reader.ids, torque_limits or (), strict=False))
        super().__init__(reader, lower=lower, upper=upper)

    def _make_check(self, bounds: Mapping[int, tuple[int, int]]) -> RegisterWriteCheck:
        restart = FeetechInstruction.REBOOT
        return RegisterWriteCheck(
            self._name, self._bus.tables, bounds, self._off(), volatile=SHADOWED, bare=(restart,)
        )

    def _restart(self, order: RebootRequest) -> SerialTransaction:
        return SerialTransaction(packet.instruction(order.id, FeetechInstruction.REBOOT), None, 0)

    def _prepare(self, ids: Sequence[int], ticks: Ints) -> Script[set[int]]:
        state = yield from self._settings(ids)
        holding = {id for id in ids if state[id]["torque_enable"]}
        yield from self._set(self._before_gains(ids))
        rows: list[Row] = []
        for id in ids:
            own = self._reader.maps[id]
            found = state[id]
            wish = self._wanted_limits.get(id)
            self._full[id] = min(found["max_torque"], 1000 if wish is None else wish)
            p, i, d = self._wanted_gains.get(id, (None, None, None))
            wanted = {a: b for a, b in zip(GAINS, (p, d, i), strict=True) if b is not None}
            rows += self._gain_rows(id, {name: found[name] for name in GAINS}, wanted)
            if "acceleration" in own:
                rows.append((id, "acceleration", 0))  # no limit: the executor shapes the motion
            if "torque_limit" in own and id not in holding:
                rows.append((id, "torque_limit", min(SOFT_START, self._full[id])))
            rows.append((id, "goal_velocity", SPEED[own.name]))
            if id in holding:
                rows.append(self._goal_row(id, ticks))
        yield from self._set(rows)
        return holding

    def _settings(self, ids: Sequence[int]) -> Script[dict[int, dict[str, int]]]:
        """Read registers 0 to 70. Raises DeviceRefused for what must not get torque."""
        state: dict[int, dict[str, int]] = {id: {} for id in ids}
        for address, size in BLOCKS:
            for id, raw in (yield from self._reader.collect(ids, address, size)).items():
                own = self._reader.maps[id]
                if address == 0 and map_of_firmware(*raw[:3]).name != own.name:
                    reason = f"firmware {raw[0]}.{raw[1]} has not the registers of an {own.name.upper()}"
                    raise DeviceRefused(self._name, id, "arming", reason)
                state[id] |= own.values(address, raw)
        for id, found in state.items():
            place = self._index[id]
            own = self._reader.maps[id]
            turns = bool(self._goals.lower[place] < 0 or self._goals.upper[place] >= own.turn)
            reasons = objections(own, found, turns=turns)
            if reasons:
                raise DeviceRefused(self._name, id, "arming", "; ".join(reasons))
        return state

    def _before_gains(self, ids: Sequence[int]) -> list[Row]:
        """Close the lock: a restarted servo, or an EPROM write that was ended, may have left it open."""
        return [(id, "lock", 1) for id in ids]

    def _soft_gains(self, id: int) -> list[Row]:
        p, d, i = GAINS
        gains = self._gains[id]
        return [(id, p, soft_gain(gains[p])), (id, d, gains[d]), (id, i, 0)]

    def _write_kept(self, id: int, field: MappedRegister, value: int) -> Script[None]:
        lock = self._reader.maps[id]["lock"]
        self._check.unlocked = id
        try:
            yield from self._write(id, lock, 0)
            yield from self._write(id, field, value)
        finally:
            self._check.unlocked = None
            # A script that is closed here leaves the lock open; `prepare` closes it before torque.
        yield from self._write(id, lock, 1)
