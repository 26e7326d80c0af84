"""The latency of a port measured, not believed: a timer in the adapter is a floor under every answer."""

from collections.abc import Iterator

from twind.config.actuator_types import CAN, ServoType
from twind.doctor.bus_probe import BusProbe
from twind.doctor.check import CheckNotApplicable, CheckUnavailable, DoctorFinding
from twind.doctor.check_context import CheckContext
from twind.doctor.serial_bus_inspector import SerialBusInspector
from twind_drivers.bus import PortError
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.prober import LONGEST_DELAY

PINGS = 12
ENOUGH = 6  # answers
PUNCTUAL = 0.9  # of the last 100 ticks
LOST = 0.2  # of all exchanges
LATER = "stop it and ask again, then the port itself is measured"
FLOOR = 0.004  # s beyond the wire: a timer of 1 ms, USB frames and a busy machine stay below
MARGIN = 0.003  # s of it that are for the frames and the machine
SLOWEST = 0.03  # s: longer than any timer that adapters have as delivered
ANSWER = 14  # bytes of the status to a ping


def floors(x: CheckContext) -> Iterator[DoctorFinding]:
    """LATENCY_FLOOR: by round trips of pings on a free port, by the daemon's own figures where one runs."""
    if x.daemon is not None:
        yield from _by_daemon(x)
        return
    if not x.lines:
        raise CheckNotApplicable("no serial port")
    silent: list[str] = []
    for name, line in x.lines.items():
        delays = _delays(line, [joint.id for joint in x.need_robot().joints if joint.bus == name])
        if len(delays) < ENOUGH:
            silent.append(f"{name}: nobody answers on {line.port}")
        else:
            wire = (len(packet.ping(1)) + ANSWER) * 10 / line.baud
            # The first meets the timer anywhere; on a busy machine one may be luck, and most are slow.
            quick = wire + sorted(delays[1:])[1]
            timer = x.bus(name).latency_timer_ms
            what = f"the quicker of {len(delays)} pings"
            yield from judge(line.port, quick, wire + LONGEST_DELAY, timer, what)
    if silent:
        raise CheckUnavailable("; ".join(silent))


def _delays(line: SerialBusInspector, ids: list[int]) -> list[float]:
    """Seconds beyond the wire's own time of each ping to the first device that answers. Raises CannotLook."""
    delays: list[float] = []
    try:
        asker = BusProbe(line.transport, line.clock, line.baud, timer=SLOWEST)
        for id in ids[:4]:
            for _ in range(PINGS):
                heard = asker.ping(id)
                if heard.data is None:
                    break
                delays.append(heard.delay)
            if delays:
                break
    except PortError as error:
        raise CheckUnavailable(str(error)) from error
    return delays


def _by_daemon(x: CheckContext) -> Iterator[DoctorFinding]:
    """Two of its hops: request to first byte, and first to last byte; their mean over the last 100 readings.

    The timer runs by itself, so a reading at a fixed rate now waits for all of it, now for none: a mean that
    is half a timer too long. What waits past the reader's deadline is lost, and looks as silence does: then
    nobody can say. A loop that is late itself proves nothing.
    """
    daemon = x.need_daemon()
    serial = [bus for bus in x.need_robot().buses if bus.kind != CAN]
    if not serial:
        raise CheckNotApplicable("no serial port")
    if x.sim:
        raise CheckNotApplicable("mode sim opens no port")
    hops = daemon.latency
    mean = [hops[name]["mean_ms"] for name in ("request", "reply") if name in hops]
    if len(mean) < 2 or None in mean:
        raise CheckUnavailable(f"the daemon hears nobody; {LATER}")
    for bus in daemon.status["buses"]:
        if bus["errors"] > LOST * bus["exchanges"]:
            lost = f"{bus['errors']} of {bus['exchanges']} readings of bus {bus['name']} were not whole"
            raise CheckUnavailable(f"{lost}, and a long latency timer looks like that too; {LATER}")
    if daemon.status["loop"]["on_time"] < PUNCTUAL:
        raise CheckUnavailable(f"the loop itself is late; {LATER}")
    slowest = max(serial, key=lambda bus: _cycle(x, bus.name))
    yield from judge(
        " ".join(str(x.ports.get(bus.name)) for bus in serial),
        sum(mean) / 1e3,
        _cycle(x, slowest.name),
        max(bus.latency_timer_ms for bus in serial),
        "the mean reading",
    )


def _cycle(x: CheckContext, bus: str) -> float:
    """Seconds that one plain reading of a bus takes on its wire, goals and return delays included."""
    kinds = [joint.type for joint in x.need_robot().joints if joint.bus == bus]
    count = len(kinds)
    data = (14 + 5 * count) + (14 + count) + count * (11 + 10)
    delays = [kind.return_delay_us for kind in kinds if isinstance(kind, ServoType)]
    return data * 10 / x.bus(bus).baud + sum(delays) * 1e-6


def judge(port: str, took: float, wire: float, timer_ms: float, what: str) -> Iterator[DoctorFinding]:
    """LATENCY_FLOOR of times in s. `timer_ms`: the adapter's, by the robot file; who wrote 16 knows of it."""
    bound = wire + max(FLOOR, timer_ms * 1e-3 + MARGIN)
    if took > bound:
        said = f"{what} took {took * 1e3:.1f} ms, the wire needs {wire * 1e3:.1f} ms"
        yield DoctorFinding("LATENCY_FLOOR", port, said, f"at most {bound * 1e3:.1f} ms")
