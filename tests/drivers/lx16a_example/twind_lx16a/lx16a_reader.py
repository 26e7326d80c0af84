"""Reader of an LX-16A bus. Each device is read alone, as soon as the one before has answered.

A reply carries no number of its request. After a missed one the same is not read again for 40 ms, in which a
late reply is dropped; one that comes later still is not recognised.
"""

from collections.abc import Sequence
from difflib import get_close_matches
from math import inf
from typing import NamedTuple

import numpy as np

from twind_drivers.bus import (
    BusSample,
    GroupWriteBatch,
    IdentifiedDevice,
    NoReply,
    PingRequest,
    Query,
    ReadRequest,
    Request,
    RequestReply,
    Script,
    SlowRegisterValues,
)
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.device_registers import RegisterAddress, unknown_register
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.half_duplex.pending_reply import wire
from twind_lx16a.lx16a_family import BAUD, DELAY, MODEL
from twind_lx16a.lx16a_packet import OVERHEAD, SIZES, LxCommand, LxReply, find_lx_packets, lx_packet

QUIET = 0.04  # s after a missed reply in which the same is not read again
LONGEST = 1.0  # s: the pause doubles with each further miss of a position
PARKED = 2  # missed positions in a row
ATTEMPTS = 8  # turns that a script waits for a reply
ADAPTER = 0.001  # s that a USB adapter adds to each read of a chain
NOTHING = SerialTransaction(b"", None, 0)


class LxRegister(NamedTuple):
    """Register by name: the command that reads it, and its place in the reply."""

    code: LxCommand
    first: int
    size: int
    signed: bool = False


REGISTERS = {
    "goal_position": LxRegister(LxCommand.GOAL, 0, 2),
    "homing_offset": LxRegister(LxCommand.OFFSET, 0, 1, signed=True),
    "min_position_limit": LxRegister(LxCommand.LIMITS, 0, 2),
    "max_position_limit": LxRegister(LxCommand.LIMITS, 2, 2),
    "temperature_limit": LxRegister(LxCommand.HEAT_LIMIT, 0, 1),
    "present_temperature": LxRegister(LxCommand.TEMPERATURE, 0, 1),
    "present_input_voltage": LxRegister(LxCommand.VOLTAGE, 0, 2),
    "present_position": LxRegister(LxCommand.POSITION, 0, 2, signed=True),
    "operating_mode": LxRegister(LxCommand.MODE, 0, 1),
    "torque_enable": LxRegister(LxCommand.LOADED, 0, 1),
}
SETTINGS = ("homing_offset", "operating_mode", "min_position_limit", "max_position_limit")


def number(register: LxRegister, data: bytes) -> int:
    """Decode a register from the reply to its command."""
    return int.from_bytes(data[register.first :][: register.size], "little", signed=register.signed)


class LxReader:
    """Reader of the devices `ids`. Arrays are (m,). Effort is never reported, velocity is a difference."""

    def __init__(self, name: str, transport: ByteTransport, ids: Sequence[int], rate_hz: float) -> None:
        self.name = name
        self.ids = tuple(ids)
        self.transport = transport
        self.registers = SlowRegisterValues.unknown(len(self.ids))
        self.line = HalfDuplexTransactor(
            name,
            transport,
            baud=BAUD,
            return_delay_s=DELAY,
            slack=min(0.002, 0.25 / rate_hz),
            find_packets=find_lx_packets,
        )
        self._again: dict[tuple[int, int], float] = {}  # (id, command) -> s, not read before
        self._misses = np.zeros(len(self.ids), np.int64)
        self._asked: tuple[int, ...] = ()  # ids of the cyclic reading under way
        self._last = np.zeros(len(self.ids))  # counts
        self._read_at = np.full(len(self.ids), -inf)
        self._velocity = np.zeros(len(self.ids))  # counts/s
        self._turn = 0

    @property
    def deadline(self) -> float:
        """Latest end of the outstanding transaction, s."""
        return self.line.deadline

    @property
    def earliest(self) -> float:
        """Return -inf: unknown."""
        return -inf

    @property
    def lags(self) -> bool:
        """Return False: the delay of a reply is no setting."""
        return False

    @property
    def late_replies(self) -> Sequence[float]:
        """Delays (s) of the replies that came too late, newest last."""
        return self.line.late_replies.delays

    # --------------------------------------------------------------------------- the cyclic reading

    def request(self, now: float, latest: float = -inf) -> None:
        """Begin the cyclic reading: pending goals and the first read leave together. Raises PortError."""
        self._asked = self._due(self.ids, LxCommand.POSITION, now)
        exchange = self._exchange(self._asked, LxCommand.POSITION, SIZES[LxCommand.POSITION])
        self.line.send(exchange, now, goals=True, latest=latest)

    def feed(self, now: float) -> bool:
        """Process received bytes; return True when the transaction is complete. Raises PortError."""
        return self.line.feed(now)

    def finish(self, now: float) -> BusSample:
        """End the cyclic reading with the received replies; zeros for silent devices."""
        exchange = self.line.end()
        if exchange is None:
            raise RuntimeError(f"{self.name}: finish without request")
        count = len(self.ids)
        position = np.zeros(count, np.int64)
        heard = np.zeros(count, np.bool_)
        if exchange.reply is not None:
            places = [self.ids.index(id) for id in self._asked]
            heard[places] = exchange.reply.heard
            position[places] = exchange.reply.data.view("<i2")[:, 0]
            self._misses[places] = np.where(heard[places], 0, self._misses[places] + 1)
            for id, place in zip(self._asked, places, strict=True):
                if not heard[place]:
                    pause = min(QUIET * 2.0 ** int(self._misses[place] - 1), LONGEST)
                    self._again[id, LxCommand.POSITION] = now + pause
        parked = self._misses >= PARKED
        self.registers.expire_torque(parked)  # who was silent so long may have lost its supply
        foreign = self.line.foreign
        self.line.foreign = 0
        return BusSample(
            sent=self.line.sent,
            received=self.line.received,
            position=position,
            velocity=self._differentiate(position, heard),
            effort=np.zeros(count, np.int64),
            error=np.zeros(count, np.uint8),
            heard=heard,
            asked=~parked,
            discarded=self.line.strays,
            foreign=foreign,
            effort_told=np.zeros(count, np.bool_),
        )

    def _differentiate(self, position: np.ndarray, answered: np.ndarray) -> np.ndarray:
        """Return the smoothed difference of positions, counts/s; 0 without two readings."""
        passed = self.line.received - self._read_at
        known = answered & (passed < QUIET)
        slope = np.divide(position - self._last, passed, out=np.zeros(len(self.ids)), where=known)
        self._velocity = np.where(known, self._velocity + 0.3 * (slope - self._velocity), 0.0)
        self._last[answered] = position[answered]
        self._read_at[answered] = self.line.received
        return np.where(answered, np.rint(self._velocity), 0.0).astype(np.int64)

    def _due(self, ids: Sequence[int], code: int, now: float) -> tuple[int, ...]:
        return tuple(id for id in ids if self._again.get((id, code), -inf) <= now)

    def _exchange(self, ids: Sequence[int], code: int, size: int) -> SerialTransaction:
        if not ids:
            return NOTHING
        first, *others = (lx_packet(id, code) for id in ids)
        then = tuple(((place,), each) for place, each in enumerate(others))
        return SerialTransaction(first, LxReply(ids, code, size), len(ids), ADAPTER * len(then), then)

    # --------------------------------------------------------------------------- the rare path

    def begin(self, query: Query, now: float, latest: float = -inf) -> None:
        """Begin one query; its address is a command. Raises PortError; TypeError for a write."""
        if not isinstance(query, PingRequest | ReadRequest):
            raise TypeError(f"{self.name}: a reader does not write: {query}")
        ids, code, size = self._parts(query)
        self.line.send(self._exchange(self._due(ids, code, now), code, size), now, latest=latest)
        self._code = code

    def _parts(self, query: Query) -> tuple[tuple[int, ...], int, int]:
        if isinstance(query, PingRequest):
            return (query.id,), LxCommand.POSITION, SIZES[LxCommand.POSITION]
        return query.ids, query.address, query.size

    def answer(self, now: float) -> RequestReply:
        """End the transaction; slow registers are kept with their time."""
        exchange = self.line.end()
        reply = exchange.reply if exchange else None
        waited = now - self.line.sent
        if reply is None:
            return RequestReply({}, {}, waited, self.line.strays)
        data = {id: reply.data[row].tobytes() for row, id in enumerate(reply.ids) if reply.heard[row]}
        for id in reply.ids:
            if id not in data:
                self._again[id, self._code] = now + QUIET
            elif id in self.ids:
                self._keep(self.ids.index(id), data[id])
        return RequestReply(data, dict.fromkeys(data, 0), waited, self.line.strays)

    def _keep(self, place: int, data: bytes) -> None:
        state = self.registers
        if self._code == LxCommand.LOADED:
            state.torque[place] = data[0]
            state.status_time[place] = self.line.received
        elif self._code == LxCommand.TEMPERATURE:
            state.temperature[place] = data[0]
        elif self._code == LxCommand.VOLTAGE:
            state.voltage[place] = int.from_bytes(data, "little") * 1e-3
            state.health_time[place] = self.line.received  # read behind the temperature
        state.version += 1

    def upkeep(self, now: float) -> Query | None:
        """Return the next slow read, round robin: torque two times in three."""
        rounds, turn = divmod(self._turn, 3)
        self._turn += 1
        if turn == 2:
            pair, place = divmod(rounds, len(self.ids))
            code = LxCommand.VOLTAGE if pair % 2 else LxCommand.TEMPERATURE
        else:
            place = (2 * rounds + turn) % len(self.ids)
            code = LxCommand.LOADED
        if self._misses[place] >= PARKED:
            return None
        return ReadRequest((self.ids[place],), code, SIZES[code])

    def span(self, query: Request) -> float:
        """Return the upper bound of a transaction's bus time (s)."""
        if isinstance(query, PingRequest | ReadRequest):
            return self.line.span(self._exchange(*self._parts(query)))
        writes = query.writes if isinstance(query, GroupWriteBatch) else (query,)
        rows = [data for each in writes for data in getattr(each, "data", {}).values()]
        return wire(sum(OVERHEAD + len(data) for data in rows), BAUD)

    # --------------------------------------------------------------------------- scripts

    def collect(self, id: int, code: int) -> Script[bytes]:
        """Read one command of one device, patiently. Raises NoReply."""
        waited = 0.0
        for _ in range(ATTEMPTS):
            reply = yield ReadRequest((id,), code, SIZES[LxCommand(code)])
            waited += reply.waited
            if id in reply.data:
                return reply.data[id]
        raise NoReply(self.name, (id,), waited, f"read {code}")

    def identify(self, *, patient: bool = False) -> Script[tuple[IdentifiedDevice, ...]]:
        """Read the settings of every id; return the devices that reply. They report no model number."""
        found = []
        for id in self.ids:
            settings = {"drive_mode": 0}
            try:
                for name in SETTINGS:
                    settings[name] = (yield from self.read(id, name)).value
            except NoReply:
                continue
            found.append(IdentifiedDevice(id, 0, MODEL, 0, settings))
        return tuple(found)

    def read(self, id: int, name: str) -> Script[RegisterAddress]:
        """Read one register by its name. Raises NoReply, KeyError, InvalidInput."""
        register = self.register(id, name)
        value = number(register, (yield from self.collect(id, register.code)))
        return RegisterAddress(name, register.code, register.size, value, self.keeps(id, name))

    def register(self, id: int, name: str) -> LxRegister:
        """Return a register. Raises KeyError for the id, InvalidInput for the name."""
        if id not in self.ids:
            raise KeyError(f"{self.name} has no id {id}; its ids are {list(self.ids)}")
        if name not in REGISTERS:
            raise unknown_register(f"an {MODEL}", name, get_close_matches(name.replace(" ", "_"), REGISTERS))
        return REGISTERS[name]

    def keeps(self, id: int, name: str) -> bool:
        """Return True for limits."""
        return self.register(id, name).code in (LxCommand.LIMITS, LxCommand.HEAT_LIMIT)
