"""Writer of a bus of Protocol 1.0: goals, torque, registers. Exists in live only.

These servos have no watchdog: they hold their last goal when their master dies. An alarm sets the torque
limit to 0, and only a new torque limit ends that. They cannot be restarted by a packet, and their EEPROM can
be written under torque.
"""

from collections.abc import Mapping, Sequence

from twind_drivers.bus import DeviceRefused, Ints, Script
from twind_drivers.device_registers import RestartResult
from twind_drivers.dynamixel1.dynamixel1_identification import derived, objections
from twind_drivers.dynamixel1.dynamixel1_reader import Dynamixel1Reader
from twind_drivers.dynamixel1.dynamixel1_registers import BLOCKS, CURRENT_MODE, GOAL, TORQUE
from twind_drivers.half_duplex.register_table import MappedRegister
from twind_drivers.half_duplex.register_writer import SHARE, RegisterWriter, Row
from twind_drivers.half_duplex.soft_gain import soft_gain

ELSEWHERE = {
    "torque_enable": "torque is switched by arming and disarming",
    "goal_position": "goals pass the gate",
    "moving_speed": "it is set by preparing for torque",
    "torque_control_mode": "modes other than joint mode are not driven",
    "goal_torque": "modes other than joint mode are not driven",
    "lock": "once locked, the EEPROM stays so until the supply is switched off",
    "id": "it would answer under another id than this bus has",
    "baud_rate": "it would answer at another baud rate than this bus has",
    "status_return_level": "below 2 it would confirm no write",
}
SOFTEST = 128  # compliance slope that damping sets
PID = ("position_p_gain", "position_i_gain", "position_d_gain")
SLOPES = ("cw_compliance_slope", "ccw_compliance_slope")


class Dynamixel1Writer(RegisterWriter):
    """Writer to the bus of `reader`. Arrays are (m,), in the order of its ids; goals in counts."""

    GOAL = GOAL
    TORQUE = TORQUE
    ELSEWHERE = ELSEWHERE

    def __init__(
        self,
        reader: Dynamixel1Reader,
        *,
        lower: Ints,
        upper: Ints,
        gains: Sequence[Mapping[str, int]] = (),
        torque_limits: Sequence[int] = (),
    ) -> None:
        """Make the writer; `lower`, `upper` (m,): counts that may be sent.

        `gains` (m): wanted content of gain registers, by name; others stay as the servo has them.
        `torque_limits` (m): of 1023; none: register 14.
        """
        self._wanted = dict(zip(reader.ids, gains, strict=False))
        self._wanted_limits = dict(zip(reader.ids, torque_limits, strict=False))
        self._reader = reader
        super().__init__(reader, lower=lower, upper=upper)

    def _prepare(self, ids: Sequence[int], ticks: Ints) -> Script[set[int]]:
        state = yield from self._settings(ids)
        holding = {id for id in ids if state[id]["torque_enable"] and state[id]["torque_limit"]}
        rows: list[Row] = []
        for id in ids:
            found = state[id]
            limit = found["max_torque"]
            self._full[id] = min(limit, self._wanted_limits.get(id, limit))
            names = [name for name in PID + SLOPES if name in self._bus.tables[id]]
            rows += self._gain_rows(id, {name: found[name] for name in names}, self._wanted.get(id, {}))
            if id not in holding:
                rows.append((id, "torque_limit", max(1, int(self._full[id] * SHARE))))
            rows.append((id, "moving_speed", 0))  # no limit: the executor shapes the motion
            if id in holding:
                rows.append(self._goal_row(id, ticks))
        # One that has torque and torque limit 0 would start at full stiffness towards an old goal.
        yield from self._set([(id, "torque_enable", 0) for id in ids if id not in holding])
        yield from self._set(rows)
        return holding

    def _settings(self, ids: Sequence[int]) -> Script[dict[int, dict[str, int]]]:
        """Read all settings. Raises DeviceRefused for what must not get torque."""
        state: dict[int, dict[str, int]] = {id: {} for id in ids}
        for block in (*BLOCKS, CURRENT_MODE):
            known = [id for id in ids if block in BLOCKS or "torque_control_mode" in self._bus.tables[id]]
            for id, values in (yield from self._bus.values(known, *block)).items() if known else ():
                state[id].update(values)
        errors = yield from self._reader.errors(ids)
        for id, found in state.items():
            found |= derived(found, errors[id])
            reasons = objections(found["model_number"], found)
            if reasons:
                raise DeviceRefused(self._name, id, "arming", "; ".join(reasons))
        return state

    def _soft_gains(self, id: int) -> list[Row]:
        gains = self._gains[id]
        if SLOPES[0] in gains:
            return [(id, name, max(SOFTEST, gains[name])) for name in SLOPES]
        p, i, _ = PID
        return [(id, p, soft_gain(gains[p])), (id, i, 0)]

    def _write_kept(self, id: int, field: MappedRegister, value: int) -> Script[None]:
        if (yield from self._bus.read(id, "lock")).value:
            reason = "is EEPROM, and lock (47) is 1: switch the supply off and on first"
            raise DeviceRefused(self._name, id, field.name, reason)
        self._check.unlocked = id
        try:
            yield from self._write(id, field, value)
        finally:
            self._check.unlocked = None

    def reboot(self, id: int, *, shut_down: bool = False) -> Script[RestartResult]:
        """Raise DeviceRefused: the protocol has no restart. KeyError for an id that is not on this bus."""
        self._bus.table(id)
        yield from ()
        reason = (
            "Protocol 1.0 has no restart. Arm again after the cause is gone, or switch the supply off and on"
        )
        raise DeviceRefused(self._name, id, "reboot", reason)
