"""A bus looked at on its own port, where no daemon holds it: opened alone, pings and reads only."""

from functools import cached_property

from twind.doctor.check import CheckUnavailable
from twind.doctor.host_inspector import HostInspector
from twind_drivers.bus import PortError
from twind_drivers.clock import Clock
from twind_drivers.dynamixel.prober import Prober
from twind_drivers.dynamixel.serial_port import SerialTransport


class SerialBusInspector:
    """One serial port at the rate of its bus. `transport`, `prober` may raise CannotLook."""

    def __init__(self, port: str, baud: int, host: HostInspector, clock: Clock) -> None:
        """Opens nothing yet: the port is opened when first used, and stays open until `close`."""
        self.port = port
        self.baud = baud
        self.host = host
        self.clock = clock
        self._open: SerialTransport | None = None

    @cached_property
    def transport(self) -> SerialTransport:
        """The open port. Raises CannotLook: held (by whom), not there, not permitted."""
        for other in self.host.holders(self.port):  # also those that took no lock: their bytes would be ours
            raise CheckUnavailable(f"{self.port} is held by pid {other.pid} ({other.command})")
        try:
            self._open = SerialTransport(self.port, self.baud)
        except PortError as error:
            raise CheckUnavailable(str(error)) from error
        return self._open

    @cached_property
    def prober(self) -> Prober:
        """Asks one question at a time; it cannot write."""
        timer = (self.transport.latency_ms or 0) * 1e-3
        return Prober(self.transport, self.clock, self.baud, timer=timer)

    def close(self) -> None:
        """Let go of the port, if it was opened."""
        if self._open is not None:
            self._open.close()
            self._open = None
        self.__dict__.pop("transport", None)
        self.__dict__.pop("prober", None)
