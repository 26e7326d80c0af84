"""The reading half of a CAN bus: cyclic reading, upkeep of the slow registers, identification.

Runs in the loop's one thread. Accepts only queries: a mirror has no object that can write. Raw units are
those of `can_units.py` for every family.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np

from twind_drivers.bus import (
    Bools,
    BusError,
    BusSample,
    DeviceRefused,
    IdentifiedDevice,
    NoReply,
    PingRequest,
    PortHandle,
    Query,
    ReadRequest,
    RegisterAddress,
    Request,
    RequestReply,
    Script,
    SlowRegisterValues,
)
from twind_drivers.can.actuator import CanActuator
from twind_drivers.can.actuator_family import ActuatorFamily, FamilyRegister, FieldRanges
from twind_drivers.can.actuator_group import ActuatorGroup
from twind_drivers.can.can_cyclic_read import ALERT, CanCyclicRead, alert
from twind_drivers.can.can_identification import identify
from twind_drivers.can.can_models import model
from twind_drivers.can.can_slow_registers import CanSlowRegisters
from twind_drivers.can.can_transactor import EXTENDED_BITS, CanTransaction, CanTransactor
from twind_drivers.can.channel import CanChannel
from twind_drivers.can.codec_factory import apart, make, ranges_of
from twind_drivers.can.register_access import (
    STATE,
    asking,
    asks_state,
    decode,
    encode_register_value,
    ordering,
    parameter_of,
    rows_of,
    state,
)
from twind_drivers.slow_read_rate import upkeep_stride

# s that an answer may take beyond its wire time, at most half a period of the loop. USB adapters hand frames
# on in batches; with 2 ms a machine at its limit lost one reading in ten (2026-11-22, 24 virtual actuators).
# a rare transaction ends the tick, so it waits for less
SLACK = 0.0035
RARE_SLACK = 0.002
SLICE = 0.002  # s of bus time that one transaction of a script or of upkeep may take at most ...
SHARE = 0.2  # ... and of a period
ROUND = 0.04  # s in which every watchdog is read once
TRIES = 3  # of a read that nobody answers
FAULTS = "hardware_error_status"  # the name under which the loop asks what is wrong


class CanReader:
    """A bus by its actuators. Arrays are in the order of `ids`, raw units of `can_units.py`.

    An actuator that tells where it is only in answer to a command (CubeMars in MIT mode) is not heard by a
    reader alone.
    """

    def __init__(
        self,
        name: str,
        channel: CanChannel,
        actuators: Sequence[CanActuator],
        *,
        bitrate: int,
        rate_hz: float = 100.0,
        slack: float | None = None,
    ) -> None:
        """`bitrate`: bit/s of the wire. `rate_hz`: how often the loop calls. `slack` (s): what an answer may
        take beyond its wire time; None: 3.5 ms, or half a period where that is less.

        Raises ValueError for no ids, ids given twice or that look alike on the wire; KeyError for an unknown
        model.
        """
        self.name = name
        self.ids = tuple(each.id for each in actuators)
        self.channel = channel
        self.rate_hz = rate_hz
        self.bitrate = bitrate
        self.fleet = ActuatorGroup(name, actuators, _families(name, actuators))
        wait = min(SLACK, 0.5 / rate_hz) if slack is None else slack
        self.line = CanTransactor(
            self.fleet, channel, bitrate=bitrate, slack=wait, rare_slack=min(RARE_SLACK, wait)
        )
        self.cyclic = CanCyclicRead(self.fleet, self.line)
        self.slow = CanSlowRegisters(self.fleet)
        # Registers that fit beside a cycle, asked and answered.
        self.at_once = max(1, int(min(SLICE, SHARE / rate_hz) * bitrate / (2 * EXTENDED_BITS)))
        self.slow.schedule(self.at_once, turns=int(ROUND * rate_hz / upkeep_stride(rate_hz)))
        self._asked: dict[Query, CanTransaction] = {}  # of upkeep: its slices come again and again
        self._query: Request | None = None

    @property
    def transport(self) -> PortHandle:
        """The channel under it."""
        return self.channel

    @property
    def registers(self) -> SlowRegisterValues:
        """The slowly read state, in the order of `ids`."""
        return self.slow.registers

    @property
    def deadline(self) -> float:
        """When the outstanding transaction ends at the latest, s."""
        return self.line.deadline

    @property
    def earliest(self) -> float:
        """When our frames and all their answers can have left the wire: each of them wakes whoever waits."""
        return self.line.earliest

    # --------------------------------------------------------------------------- the cyclic reading

    def request(self, now: float) -> None:
        """Begin the cyclic reading: pending goals and questions leave together. Raises PortError."""
        self.line.send(self.cyclic.next(self.line.commanded_rows(now), now), now, goals=True)
        self._overhear(now)

    def feed(self, now: float) -> bool:
        """Take what has arrived; True when the transaction is complete. Raises PortError."""
        return self.line.feed(now)

    def finish(self, now: float) -> BusSample:
        """End the cyclic reading with what was heard; zeros where an actuator stayed silent."""
        if self.line.end() is None:
            raise RuntimeError(f"{self.name}: finish without request")
        sample = self.cyclic.sample(now)
        self._keep(sample.heard)
        if self.cyclic.limp.any():
            self.slow.doubt(self.cyclic.limp & self.cyclic.energised)
        return sample

    # --------------------------------------------------------------------------- the rare path

    def begin(self, query: Query, now: float) -> None:
        """Begin one query. Raises PortError; TypeError for anything that writes."""
        if not isinstance(query, PingRequest | ReadRequest):
            raise TypeError(f"{self.name}: a reader does not write: {query}")
        self.start(query, self._asking(query, now), now)

    def _asking(self, query: Query, now: float) -> CanTransaction:
        if isinstance(query, PingRequest) or asks_state(query):
            rows = rows_of(self.fleet, query)
            if not rows.any():
                return self.cyclic.nothing
            return replace(self.cyclic.make_cyclic_request(rows, now), states=rows & ~self.fleet.replies)
        found = self._asked.get(query)
        return asking(self.fleet, query) if found is None else found

    def start(self, request: Request, exchange: CanTransaction, now: float) -> None:
        """Begin a transaction whose frames are made. Raises PortError."""
        self._query = None
        self.line.send(exchange, now, order=not isinstance(request, PingRequest | ReadRequest))
        self._overhear(now)
        self._query = request

    def answer(self, now: float) -> RequestReply:
        """End it. What was told of the slow registers is kept, of those whose answers are believed."""
        exchange = self.line.end()
        request = self._query
        self._query = None
        waited = now - self.line.sent
        if exchange is None or self.line.idle:
            return RequestReply({}, {}, waited, self.line.strays)
        heard = self.line.heard
        told = self.cyclic.note(heard, now)
        if heard.answers or told.any():
            self._keep(told)
        spoke = heard.count > 0
        spoke[[each.row for each in heard.answers]] = True
        alerted = alert(heard.fault)
        error = {self.ids[row]: int(ALERT) if alerted[row] else 0 for row in np.flatnonzero(spoke).tolist()}
        return RequestReply(self._replies_by_id(request, exchange), error, waited, self.line.strays)

    def _overhear(self, now: float) -> None:
        """What was told between two transactions, by those who tell it of themselves (ODrive's heartbeat)."""
        if self.line.aside is not None:
            tell = (self.line.aside.count > 0) & ~self.fleet.replies
            self.slow.update_from_feedback(
                self.line.aside, tell, self.cyclic.barred & self.cyclic.watched, now
            )

    def _keep(self, rows: Bools) -> None:
        heard = self.line.heard
        at = self.line.received
        self.slow.update_from_feedback(heard, rows, self.cyclic.barred & self.cyclic.watched, at)
        if heard.answers:
            self.slow.update_from_replies(
                heard, self.cyclic.proven, self.cyclic.barred & self.cyclic.watched, at
            )

    def _replies_by_id(self, request: Request | None, exchange: CanTransaction) -> dict[int, bytes]:
        """By id: the bytes asked for; of an order nothing, from whoever answered it."""
        heard = self.line.heard
        if isinstance(request, PingRequest | ReadRequest) and asks_state(request):
            there = rows_of(self.fleet, request) & ~np.isnan(heard.position)
            return {
                self.ids[row]: state(int(heard.enabled[row]), int(heard.fault[row]))
                for row in np.flatnonzero(there).tolist()
            }
        if isinstance(request, ReadRequest):
            return {
                self.ids[each.row]: each.data
                for each in heard.answers
                if (each.row, each.address) in exchange.registers and not each.written
            }
        spoke = (heard.count > 0) & (heard.count >= exchange.expect)
        spoke[[each.row for each in heard.answers]] = True
        return {self.ids[row]: b"" for row in np.flatnonzero(spoke).tolist()}

    def upkeep(self, now: float) -> Query | None:
        """The next slice of the slow registers, round robin; None where nothing must be asked.

        Who is parked goes on being asked by the cyclic reading itself.
        """
        query = self.slow.next()
        if query is not None and query not in self._asked:
            self._asked[query] = asking(self.fleet, query)
        return query

    def span(self, query: Request) -> float:
        """Bus time (s) that a transaction takes at most, its timeout excluded."""
        try:
            if isinstance(query, PingRequest | ReadRequest):
                return self.line.span(self._asking(query, -inf))
            return self.line.span(ordering(self.fleet, query))
        except (BusError, ValueError, KeyError):  # told when it is begun
            return 0.0

    # --------------------------------------------------------------------------- scripts

    @property
    def lags(self) -> bool:
        """Never: no setting of these devices delays their answers."""
        return False

    def identify(self, *, patient: bool = False) -> Script[tuple[IdentifiedDevice, ...]]:
        """Ask everybody where he is and read his registers; devices that answer, in order of `ids`."""
        return identify(self.fleet, self.at_once)

    def read(self, id: int, name: str) -> Script[RegisterAddress]:
        """One register by its name; a float in thousandths of its unit.

        `hardware_error_status`: the fault bits of the contract. Raises NoReply, DeviceRefused, KeyError.
        """
        row = self.fleet.row(id)
        if name == FAULTS:
            return (yield from self._faults(id))
        parameter = parameter_of(self.fleet, row, name)
        self._readable(row, id, parameter)
        waited = 0.0
        for _ in range(TRIES):
            reply = yield ReadRequest((id,), parameter.address, 4)
            waited += reply.waited
            if id in reply.data:
                return self._register(id, parameter, reply.data[id])
        raise NoReply(self.name, [id], waited, f"read of {parameter.name}")

    def keeps(self, id: int, name: str) -> bool:
        """Never: what is written here is RAM, and nothing orders it to be saved."""
        return False

    def _readable(self, row: int, id: int, parameter: FamilyRegister) -> None:
        try:
            self.fleet.read(row, parameter)
        except ValueError as error:
            raise DeviceRefused(self.name, id, parameter.name, str(error)) from None

    def _register(self, id: int, parameter: FamilyRegister, data: bytes) -> RegisterAddress:
        try:
            value = encode_register_value(parameter, decode(parameter, data))
        except ValueError as error:
            raise DeviceRefused(self.name, id, parameter.name, str(error)) from None
        return RegisterAddress(parameter.name, parameter.address, 4, value, parameter.kept)

    def _faults(self, id: int) -> Script[RegisterAddress]:
        waited = 0.0
        for _ in range(TRIES):
            reply = yield ReadRequest((id,), STATE, 3)
            waited += reply.waited
            _, bits, told = reply.data.get(id, bytes(3))
            if told:
                return RegisterAddress(FAULTS, STATE, 1, bits)
        known = int(self.registers.fault[self.fleet.row(id)])
        if known >= 0:  # its family tells faults unasked only
            return RegisterAddress(FAULTS, STATE, 1, known)
        raise NoReply(self.name, [id], waited, f"read of {FAULTS}")


def _families(name: str, actuators: Sequence[CanActuator]) -> list[tuple[ActuatorFamily, list[int]]]:
    """The actuators' families in order of their first, each with its rows."""
    kinds: dict[str, list[int]] = {}
    for row, each in enumerate(actuators):
        kinds.setdefault(model(each.model).family, []).append(row)
    made = [(_family(name, kind, [actuators[row] for row in rows]), rows) for kind, rows in kinds.items()]
    apart(name, [family for family, _ in made])
    return made


def _family(name: str, kind: str, own: Sequence[CanActuator]) -> ActuatorFamily:
    table = ranges_of([model(each.model) for each in own])
    ranges = FieldRanges(
        np.array([each.position for each in own]),
        np.array([each.velocity for each in own]),
        np.array([each.torque for each in own]),
        table.kp,
        table.kd,
    )
    feedback = [each.feedback_id for each in own]
    return make(
        kind,
        name,
        [each.id for each in own],
        [each.model for each in own],
        ranges=ranges,
        feedback_ids=feedback,
    )
