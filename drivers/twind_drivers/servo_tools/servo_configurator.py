"""Writes to one servo on an exclusively opened port, each verified. Blocks.

An answer to a write is no proof: one that changes id or rate may be given anywhere, and answers get lost. So
every write is judged by what is read afterwards, where the servo then stands.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial

from twind.command_line.verb import Rejected
from twind_drivers.bus import PortError
from twind_drivers.clock import Clock, MonotonicClock
from twind_drivers.ports.serial_port import SerialTransport
from twind_drivers.servo_tools.bus_scan import PROBES, REMEDY
from twind_drivers.servo_tools.family_tools import FamilyTools, ServoLocation
from twind_drivers.servo_tools.prober import PortProber, ProbeWindow
from twind_drivers.servo_tools.scan_protocol import (
    ScanProtocol,
    ScanStatus,
    ServoIdentity,
    ServoRegister,
    ServoTable,
)

TRIES = 3  # writes of one register
TORQUE = "torque_enable"  # register
TORQUE_ON = "{}: its torque is on: take its power away and give it back"
LOCK = "lock"  # register: 0 while settings are stored


class WritableProber(PortProber):
    """A prober that can write too."""

    def write(self, id: int, address: int, data: bytes) -> ProbeWindow:
        """`data` to `address` of one device; what came back."""
        return self._exchange(self.protocol.write(id, address, data), 0)


ProberAtRate = Callable[[int], WritableProber]  # sets the port to a rate in bit/s


def open_writable(port: str, protocol: ScanProtocol, stack: ExitStack) -> ProberAtRate:
    """Open a port exclusively until `stack` ends; nothing is sent. Raises PortError."""
    transport = SerialTransport(port, 57_600)  # which every adapter has
    stack.callback(transport.close)
    return partial(_at_rate, transport, MonotonicClock(), protocol)


def _at_rate(transport: SerialTransport, clock: Clock, protocol: ScanProtocol, baud: int) -> WritableProber:
    transport.set_baud(baud)
    return WritableProber(transport, clock, baud, protocol, timer=(transport.latency_ms or 0) * 1e-3)


class ServoConfigurator:
    """One servo of a known model. Every method may raise PortError; Rejected: it did not do it."""

    def __init__(
        self,
        at: ProberAtRate,
        tools: FamilyTools,
        model: int,
        table: ServoTable,
        place: ServoLocation,
    ) -> None:
        """`at` sets the port to a rate; `model`: number of the servo's model."""
        self._at = at
        self._tools = tools
        self._model = model
        self.table = table
        self.place = place
        self._setter = at(place.baud)

    def is_free(self, place: ServoLocation) -> bool:
        """Return whether no device answers there, not even garbled, in several attempts."""
        setter = self._at(place.baud)
        heard = [setter.ping(place.id) for _ in range(PROBES)]
        self._setter = self._at(self.place.baud)
        return not any(each.raw for each in heard)

    def read(self, names: Sequence[str]) -> dict[str, int]:
        """Registers by name, whatever kind of memory they are in."""
        values: dict[str, int] = {}
        fields = [self.table[name] for name in names]
        for kind in (True, False):
            some = [field for field in fields if field.eeprom is kind]
            values |= self._block(some) if some else {}
        return {name: values[name] for name in names}

    def identity(self) -> ServoIdentity | None:
        """Return what answers at its place now; None: no single servo of the family."""
        return self._identity(self._setter, self.place.id)

    @contextmanager
    def unlocked(self) -> Iterator[None]:
        """Open the lock of a family that has one, for writes of settings; it is closed and read back after.

        The lock is RAM: a servo that loses its power in between closes it by itself.
        """
        if not self._tools.locks:
            yield
            return
        self.write(LOCK, 0)
        try:
            yield
        except BaseException:
            with suppress(Rejected, PortError):
                self.write(LOCK, 1)
            raise
        self.write(LOCK, 1)

    def write(self, name: str, value: int) -> None:
        """One register, read back. The servo stays where it is: not for its id or its rate."""
        field = self.table[name]
        refused = ""
        for _ in range(TRIES):
            heard = self._setter.write(self.place.id, field.address, field.encode(value))
            refused = self._refusal(heard) or refused
            if self.read([name])[name] == value:
                return
        why = refused or f"it reads {self.read([name])[name]}"
        raise Rejected(f"{self.place}: {name} ({field.address}) = {value}: {why}")

    def move(self, to: ServoLocation) -> None:
        """Its id, then its rate. Interrupted, it stands at `place`, at the new id, or at `to`."""
        if to.id != self.place.id:
            self._move("id", to.id, ServoLocation(to.id, self.place.baud))
        if to.baud != self.place.baud:
            code = self._tools.baud_code(to.baud)
            if code is None:
                raise Rejected(
                    f"{self.place}: sources differ on how these servos are set to {to.baud} baud: set it by "
                    "the vendor's tool, then the same command does the rest"
                )
            self._move("baud_rate", code, to)

    def _move(self, name: str, value: int, to: ServoLocation) -> None:
        field = self.table[name]
        before = self.place
        refused = ""
        field.check(value)
        for _ in range(TRIES):
            heard = self._setter.write(before.id, field.address, field.encode(value))
            refused = self._refusal(heard) or refused
            if self._stands(to):
                return
            if not self._stands(before):
                break
        raise Rejected(
            f"{before} was told to be {to}, and {refused or 'does not answer there'}: is its power on? "
            "The same command once more looks for it at both places"
        )

    def _stands(self, place: ServoLocation) -> bool:
        """Return whether one servo of this model answers there; then that becomes its place."""
        setter = self._setter if place.baud == self._setter.baud else self._at(place.baud)
        for _ in range(PROBES):
            found = self._identity(setter, place.id)
            if found is not None and found.model == self._model:
                self.place = place
                self._setter = setter
                return True
        self._setter = self._at(self.place.baud)
        return False

    def _identity(self, setter: WritableProber, id: int) -> ServoIdentity | None:
        protocol = self._tools.protocol
        address, size = protocol.identity
        heard = setter.read(id, address, size) if size else setter.ping(id)
        sound = _sound(heard, id, size or protocol.ping_size)
        return protocol.identify(id, sound[0].data) if len(sound) == 1 and not heard.strays else None

    def _refusal(self, reply: ProbeWindow) -> str:
        """Return the reason why a servo refused a write; empty: it did not refuse, or sent no status."""
        return next((why for each in reply.statuses if (why := self._tools.refusal(each.error))), "")

    def _block(self, fields: Sequence[ServoRegister]) -> Mapping[str, int]:
        """The values of registers of one memory, by the smallest block that holds them."""
        first = min(each.address for each in fields)
        end = max(each.end for each in fields)
        several = False
        for _ in range(PROBES):
            heard = self._setter.read(self.place.id, first, end - first)
            sound = _sound(heard, self.place.id, end - first)
            several |= len(sound) > 1
            if len(sound) == 1 and not heard.strays:
                return {each.key: each.decode(sound[0].data[each.address - first :]) for each in fields}
        why = f"two devices answer: {REMEDY}" if several else "no clear answer to a read: is its power on?"
        raise Rejected(f"{self.place}: {why}")


def _sound(reply: ProbeWindow, id: int, size: int) -> list[ScanStatus]:
    return [each for each in reply.statuses if each.id == id and len(each.data) == size]
