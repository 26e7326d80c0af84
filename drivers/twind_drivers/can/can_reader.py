"""Reader of a CAN bus: cyclic reading, slow registers, identification.

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
    Request,
    RequestReply,
    Script,
    SlowRegisterValues,
)
from twind_drivers.can.actuator import CanActuatorIdentity
from twind_drivers.can.actuator_family import ActuatorFamily, FamilyRegister, FieldRanges
from twind_drivers.can.actuator_group import ActuatorGroup
from twind_drivers.can.can_cycle_budget import registers_at_once
from twind_drivers.can.can_cyclic_read import ALERT, CanCyclicRead, alert
from twind_drivers.can.can_identification import identify
from twind_drivers.can.can_models import model
from twind_drivers.can.can_slow_registers import CanSlowRegisters
from twind_drivers.can.can_transaction import CanTransaction
from twind_drivers.can.can_transactor import CanTransactor
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
from twind_drivers.device_registers import RegisterAddress
from twind_drivers.ports.channel import CanChannel
from twind_drivers.slow_read_rate import upkeep_stride

# s that a reply may take beyond its wire time, at most half a period of the loop. USB adapters deliver frames
# in batches; with 2 ms a machine at its limit lost one reading in ten (2026-11-22, 24 virtual actuators).
# A rare transaction ends the tick, so it waits less.
SLACK = 0.0035
RARE_SLACK = 0.002
ROUND = 0.04  # s in which every watchdog is read once: 25 Hz, since 20 Hz are required
TRIES = 3  # requests before NoReply: one lost frame is no missing device
FAULTS = "hardware_error_status"  # name under which the loop reads the fault bits


class CanReader:
    """Reader of the actuators of one bus. Arrays are (m,), in the order of `ids`, in units of `can_units.py`.

    An actuator that reports its position only in reply to a command (CubeMars in MIT mode) stays silent
    towards a reader alone.
    """

    def __init__(
        self,
        name: str,
        channel: CanChannel,
        actuators: Sequence[CanActuatorIdentity],
        *,
        bitrate: int,
        rate_hz: float = 100.0,
        slack: float | None = None,
    ) -> None:
        """Make the reader; `bitrate`: bit/s. `rate_hz`: rate of the loop.

        `slack` (s): time that a reply may take beyond its wire time; None: 3.5 ms, or half a period where
        that is less.

        Raises ValueError for no ids, ids given twice or ids with the same frame ids; KeyError for an unknown
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
        # Registers whose requests and replies fit beside a cycle.
        self.at_once = registers_at_once(bitrate, rate_hz)
        self.slow.schedule(self.at_once, turns=int(ROUND * rate_hz / upkeep_stride(rate_hz)))
        self._upkeep_transactions: dict[Query, CanTransaction] = {}  # upkeep repeats its slices
        self._query: Request | None = None

    @property
    def transport(self) -> PortHandle:
        """Channel of the bus."""
        return self.channel

    @property
    def registers(self) -> SlowRegisterValues:
        """Slowly read state, in the order of `ids`."""
        return self.slow.registers

    @property
    def deadline(self) -> float:
        """Latest end of the outstanding transaction, s."""
        return self.line.deadline

    @property
    def earliest(self) -> float:
        """Earliest time (s) of all frames and replies on the wire; each wake before it costs CPU."""
        return self.line.earliest

    # --------------------------------------------------------------------------- the cyclic reading

    def request(self, now: float, latest: float = -inf) -> None:
        """Begin the cyclic reading: pending goals and requests leave together. Raises PortError.

        `latest` is not used: frames come by interrupt, and the reader's slack covers their delays.
        """
        self.line.send(self.cyclic.next(self.line.commanded_rows(now), now), now, goals=True)
        self._take_unrequested(now)

    def feed(self, now: float) -> bool:
        """Process received frames; return True when the transaction is complete. Raises PortError."""
        return self.line.feed(now)

    def finish(self, now: float) -> BusSample:
        """End the cyclic reading with the received replies; zeros for silent actuators."""
        if self.line.end() is None:
            raise RuntimeError(f"{self.name}: finish without request")
        sample = self.cyclic.sample(now)
        self._keep(sample.heard)
        if self.cyclic.silent is not None:
            self.slow.expire_faults(self.cyclic.silent & ~sample.heard)
        if self.cyclic.limp.any():
            self.slow.doubt(self.cyclic.limp & self.cyclic.energised)
        return sample

    # --------------------------------------------------------------------------- the rare path

    def begin(self, query: Query, now: float, latest: float = -inf) -> None:
        """Begin one query. Raises PortError; TypeError for anything that writes. `latest` is not used."""
        if not isinstance(query, PingRequest | ReadRequest):
            raise TypeError(f"{self.name}: a reader does not write: {query}")
        self.start(query, self._transaction(query, now), now)

    def _transaction(self, query: Query, now: float) -> CanTransaction:
        if isinstance(query, PingRequest) or asks_state(query):
            rows = rows_of(self.fleet, query)
            if not rows.any():
                return self.cyclic.nothing
            return replace(self.cyclic.make_cyclic_request(rows, now), states=rows & ~self.fleet.replies)
        found = self._upkeep_transactions.get(query)
        return asking(self.fleet, query) if found is None else found

    def start(self, request: Request, exchange: CanTransaction, now: float) -> None:
        """Begin a transaction with encoded frames. Raises PortError."""
        self._query = None
        self.line.send(exchange, now, order=not isinstance(request, PingRequest | ReadRequest))
        self._take_unrequested(now)
        self._query = request

    def answer(self, now: float) -> RequestReply:
        """End the transaction. Slow registers of actuators with proven replies are kept."""
        exchange = self.line.end()
        request = self._query
        self._query = None
        waited = now - self.line.sent
        if exchange is None or self.line.idle:
            return RequestReply({}, {}, waited, self.line.strays)
        feedback = self.line.heard
        proven = self.cyclic.note(feedback, now)
        if feedback.answers or proven.any():
            self._keep(proven)
        spoke = feedback.count > 0
        spoke[[each.row for each in feedback.answers]] = True
        alerted = alert(feedback.fault)
        error = {self.ids[row]: int(ALERT) if alerted[row] else 0 for row in np.flatnonzero(spoke).tolist()}
        return RequestReply(self._replies_by_id(request, exchange), error, waited, self.line.strays)

    def _take_unrequested(self, now: float) -> None:
        """Keep slow registers that actuators sent by themselves between transactions (ODrive's heartbeat)."""
        if self.line.aside is not None:
            reporting = (self.line.aside.count > 0) & ~self.fleet.replies
            self.slow.update_from_feedback(
                self.line.aside, reporting, self.cyclic.barred & self.cyclic.watched, now
            )

    def _keep(self, rows: Bools) -> None:
        feedback = self.line.heard
        at = self.line.received
        self.slow.update_from_feedback(feedback, rows, self.cyclic.barred & self.cyclic.watched, at)
        if feedback.answers:
            self.slow.update_from_replies(
                feedback, self.cyclic.proven, self.cyclic.barred & self.cyclic.watched, at
            )

    def _replies_by_id(self, request: Request | None, exchange: CanTransaction) -> dict[int, bytes]:
        """Return the requested bytes by id; for an order, an empty entry for each id that replied."""
        feedback = self.line.heard
        if isinstance(request, PingRequest | ReadRequest) and asks_state(request):
            there = rows_of(self.fleet, request) & ~np.isnan(feedback.position)
            return {
                self.ids[row]: state(int(feedback.enabled[row]), int(feedback.fault[row]))
                for row in np.flatnonzero(there).tolist()
            }
        if isinstance(request, ReadRequest):
            return {
                self.ids[each.row]: each.data
                for each in feedback.answers
                if (each.row, each.address) in exchange.registers and not each.written
            }
        spoke = (feedback.count > 0) & (feedback.count >= exchange.expect)
        spoke[[each.row for each in feedback.answers]] = True
        return {self.ids[row]: b"" for row in np.flatnonzero(spoke).tolist()}

    def upkeep(self, now: float) -> Query | None:
        """Return the next slice of the slow registers, round robin; None: no request is due.

        Parked actuators stay in the cyclic request.
        """
        query = self.slow.next()
        if query is not None and query not in self._upkeep_transactions:
            self._upkeep_transactions[query] = asking(self.fleet, query)
        return query

    def span(self, query: Request) -> float:
        """Return the upper bound of a transaction's bus time (s), its timeout excluded."""
        try:
            if isinstance(query, PingRequest | ReadRequest):
                return self.line.span(self._transaction(query, inf))
            return self.line.span(ordering(self.fleet, query))
        except (BusError, ValueError, KeyError):  # `begin` raises it to the caller
            return 0.0

    # --------------------------------------------------------------------------- scripts

    @property
    def lags(self) -> bool:
        """Return False: no setting of these devices delays their replies."""
        return False

    @property
    def late_replies(self) -> Sequence[float]:
        """Return nothing: the frames carry no request that a late one could be matched to."""
        return ()

    def identify(self, *, patient: bool = False) -> Script[tuple[IdentifiedDevice, ...]]:
        """Request position and registers of all devices; return those that reply, in order of `ids`."""
        return identify(self.fleet, self.at_once)

    def read(self, id: int, name: str) -> Script[RegisterAddress]:
        """Read one register by its name; a float in thousandths of its unit.

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
        """Return False: writes go to RAM, and no code here orders to save it."""
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
            _, bits, reported = reply.data.get(id, bytes(3))
            if reported:
                return RegisterAddress(FAULTS, STATE, 1, bits)
        known = int(self.registers.fault[self.fleet.row(id)])
        if known >= 0:  # its family reports faults only by itself
            return RegisterAddress(FAULTS, STATE, 1, known)
        raise NoReply(self.name, [id], waited, f"read of {FAULTS}")


def _families(name: str, actuators: Sequence[CanActuatorIdentity]) -> list[tuple[ActuatorFamily, list[int]]]:
    """Return the actuators' families in order of their first, each with its rows."""
    kinds: dict[str, list[int]] = {}
    for row, each in enumerate(actuators):
        kinds.setdefault(model(each.model).family, []).append(row)
    made = [(_family(name, kind, [actuators[row] for row in rows]), rows) for kind, rows in kinds.items()]
    apart(name, [family for family, _ in made])
    return made


def _family(name: str, kind: str, own: Sequence[CanActuatorIdentity]) -> ActuatorFamily:
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
