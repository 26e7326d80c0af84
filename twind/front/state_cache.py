"""State cache of the front: the robot's state, and its JSON, where each piece is encoded once per news.

Front process. Reads the loop's news, independent of clients.
"""

from itertools import starmap
from math import isfinite
from typing import Any

import msgspec

from twind.briefing import Briefing
from twind.front.joint_naming import JointNames
from twind.link import Event, LatencyInfo, LoopInfo, Overview, Tick, VerdictReport

# Bits of a servo's hardware error register (Protocol 2.0, address 70), and of what the CAN drivers make of a
# fault (`twind_drivers.can.actuator_family`); bit 8: its last answer's alert.
FAULT_BITS = {
    0: "input_voltage",
    1: "not_calibrated",
    2: "overheating",
    3: "encoder",
    4: "electrical_shock",
    5: "overload",
    6: "communication_lost",
    7: "unknown_fault",
    8: "alert",
}
IMU = (("gyro", 0, 3), ("acceleration", 3, 6), ("quaternion", 6, 10))  # where they are in `Tick.imu`
# fields of `Event` and `Status` of the interface; a reason that does not apply is null
EVENT = ("time", "sequence", "level", "code", "message", "annotation")
EVENT_REASONS = ("id", "phase", "before", "cause", "stop")
STATUS_OF_TICK = ("mode", "state", "motion", "armed", "inherited")
STATUS_OF_OVERVIEW = (
    *("hw_connected", "sim_connected", "latency_ms", "latency_avg_ms", "latency_max_ms", "violations"),
    *("skew_ms", "skew_max_ms", "lease", "latched", "supply_relay", "stop_button", "fall", "torque_on"),
)
_TORQUE = {1: True, 0: False}

_json = msgspec.json.Encoder()  # writes NaN and the infinities as null


def encode(value: Any) -> bytes:
    """JSON; NaN and infinities become null."""
    return _json.encode(value)


Slow = tuple[list[float], list[float], list[bool | None], list[bool | None], list[list[str]]]


class JointSnapshot(msgspec.Struct):
    """One joint, as `Joint` of the interface. NaN where unknown."""

    name: str
    bus: str
    id: int
    position: float
    velocity: float
    effort: float
    goal: float
    simulated: float
    temperature: float
    voltage: float
    age_ms: float
    heard: bool
    torque: bool | None
    calibrated: bool
    verified: bool | None
    faults: list[str]
    external_nm: float | None
    external_sd_nm: float | None
    contact: bool | None


class StateCache:
    """The latest tick and overview of one robot. Nothing is known until both have come."""

    def __init__(self, briefing: Briefing) -> None:
        self.briefing = briefing
        self.names = JointNames([joint.name for joint in briefing.joints])
        self.tick: Tick | None = None
        self.overview: Overview | None = None
        self.flight: dict[str, object] | None = None  # `Flight` of the interface; None: nothing is recorded
        self.streams: list[dict[str, Any]] = []  # `[]Streaming`
        self.gap: dict[str, object] | None = None  # `Gap`; None: no figures
        self._cache: dict[str, bytes] = {}
        self._last_status: tuple[Any, Any, bytes] | None = None  # last status: content, encoding
        self._slow: dict[str, msgspec.Raw] = {}
        self._histograms: dict[str, LatencyInfo] = {}  # of each hop the last with its histogram
        self._lateness: LoopInfo | None = None  # the same
        self._columns: Slow | None = None

    def apply_briefing(self, briefing: Briefing) -> None:
        """Take a new briefing: the same robot with other limits, gains or settings."""
        self.briefing = briefing
        self._cache.clear()

    @property
    def is_known(self) -> bool:
        """True once a tick and an overview have come."""
        return self.tick is not None and self.overview is not None

    def take(self, news: Tick | Overview) -> None:
        """Newer news replace older ones."""
        self._cache.clear()
        if isinstance(news, Tick):
            self.tick = news
        else:
            self.overview = news
            self._histograms |= {hop.hop: hop for hop in news.latencies if hop.histogram is not None}
            self._lateness = news.loop if news.loop.lateness is not None else self._lateness
            self._slow = {
                "faults": msgspec.Raw(encode(self.names.findings(news.faults))),
                "buses": msgspec.Raw(encode(news.buses)),
                "loop": msgspec.Raw(encode(self._loop(news.loop))),
            }
            self._columns = _slow_columns(news)

    def stream(self, streams: list[dict[str, object]]) -> None:
        """Replace the list of current streamers; each call passes a new list."""
        self.streams = streams
        self._cache.pop("status", None)

    # ------------------------------------------------------------------------------ pieces of answers

    def status(self) -> bytes:
        """Return `Status` of the interface, encoded; the same object until its content changes."""
        return self._once("status", self._kept_status)

    def joints(self) -> bytes:
        """Return `[]Joint` of the interface, encoded."""
        return self._once("joints", self._joints)

    def state(self) -> bytes:
        """Return topic `state`, encoded: joints, their mode, skew, the IMU.

        The skew is the time between the readings of the buses, ms.
        """
        assert self.tick is not None
        parts = self.joints() + b',"mode":' + encode(self.tick.mode)
        parts += b',"skew_ms":' + encode(self.tick.skew * 1e3)
        return parts + b',"imu":' + encode(_imu(self.tick)) if self.tick.imu else parts

    def raw(self) -> bytes:
        """Return topic `raw`, encoded: the values on the wire of every actuator.

        They are ticks, effort and age in ms.
        """
        assert self.tick is not None
        ticks = memoryview(self.tick.raw).cast("q").tolist()
        age = _floats(self.tick.raw_age)
        efforts = _floats(self.tick.raw_effort)
        return encode(
            {
                "names": [joint.actuator or joint.name for joint in self.briefing.joints],
                "ticks": [one if isfinite(old) else None for one, old in zip(ticks, age, strict=True)],
                "effort": [int(one) if isfinite(one) else None for one in efforts],
                "age_ms": [each * 1e3 for each in age],
            }
        )

    def latency(self, *, whole: bool = False) -> bytes:
        """Return `[]Latency` of the interface, encoded. `whole`: with the histograms as last reported."""
        assert self.overview is not None
        hops = [self._hop(hop, whole=whole) for hop in self.overview.latencies]
        return encode(hops)

    def robot(self) -> bytes:
        """The reply's parameters of GetRobot, encoded."""
        b = self.briefing
        return encode({"robot": b.description, "calibration": b.calibration, "mjcf": b.mjcf})

    def event(self, event: Event) -> bytes:
        """Return `Event` of the interface, encoded."""
        values = {key: getattr(event, key) for key in EVENT}
        reasons = {key: getattr(event, key) or None for key in EVENT_REASONS}
        return encode(values | {"findings": self.names.findings(event.findings)} | reasons)

    def verdict(self, moment: VerdictReport) -> bytes:
        """Return topic `verdicts`, encoded: the verdict, and the id of its trajectory (null: none)."""
        return encode(self.names.verdict(moment.verdict)) + b',"id":' + encode(moment.id or None)

    def _hop(self, hop: LatencyInfo, *, whole: bool) -> LatencyInfo:
        last = self._histograms.get(hop.hop) if whole else None
        counts, total = (None, None) if last is None else (last.histogram, last.histogram_sum_ms)
        return msgspec.structs.replace(hop, histogram=counts, histogram_sum_ms=total)

    def _loop(self, loop: LoopInfo) -> LoopInfo:
        last = self._lateness or loop
        return msgspec.structs.replace(loop, lateness=last.lateness, lateness_sum_ms=last.lateness_sum_ms)

    def _once(self, key: str, make: Any) -> bytes:
        made = self._cache.get(key)
        if made is None:
            made = self._cache[key] = make()
        return made

    def _kept_status(self) -> bytes:
        tick = self.tick
        assert tick is not None
        held = self.overview, self.flight, self.streams, self.briefing, self.gap
        modes = (tick.mode, tick.state, tick.motion)
        of = (*map(id, held), *modes, tick.armed, tick.inherited)
        if self._last_status is None or self._last_status[0] != of:
            self._last_status = of, held, self._status()  # the held objects keep their ids unique
        return self._last_status[2]

    def _status(self) -> bytes:
        tick = self.tick
        overview = self.overview
        assert tick is not None
        assert overview is not None
        of_tick = {key: getattr(tick, key) for key in STATUS_OF_TICK}
        of_overview = {key: getattr(overview, key) for key in STATUS_OF_OVERVIEW}
        head = {"version": self.briefing.version, "robot": self.briefing.robot}
        unwatched = [joint.name for joint in self.briefing.joints if not joint.watchdog]
        tail = {
            "flight": self.flight,
            "streams": self.streams,
            "unwatched": unwatched,
            "bodiless": self.briefing.bodiless,
            "gap": self.gap,
        }
        return encode(head | of_tick | of_overview | tail | self._slow)

    def _joints(self) -> bytes:
        tick = self.tick
        columns = self._columns
        assert tick is not None
        assert columns is not None
        known = [(joint.name, joint.bus, joint.id, joint.calibrated) for joint in self.briefing.joints]
        names, buses, ids, calibrated = zip(*known, strict=True) if known else ((), (), (), ())
        temperature, voltage, torque, verified, faults = columns
        count = len(known)
        external: list[float | None] = [*_floats(tick.external)] or [None] * (2 * count)
        touched: list[bool | None] = [each != 0.0 for each in external[2 * count :]]
        rows = zip(
            names,
            buses,
            ids,
            _floats(tick.position),
            _floats(tick.velocity),
            _floats(tick.effort),
            _floats(tick.goal),
            _floats(tick.simulated),
            temperature,
            voltage,
            [age * 1e3 for age in _floats(tick.age)],
            [heard != 0 for heard in tick.heard],
            torque,
            calibrated,
            verified,
            faults,
            external[:count],
            external[count : 2 * count],
            touched or [None] * count,  # an older flight file tells no contact
            strict=True,
        )
        return encode(list(starmap(JointSnapshot, rows)))


def _floats(data: bytes) -> list[float]:
    numbers: Any = memoryview(data).cast("d").tolist()  # typed as ints whatever the format is
    return list(numbers)


def _slow_columns(news: Overview) -> Slow:
    """Temperature, voltage, torque, verified and faults of each joint."""
    torque = [_TORQUE.get(value) for value in memoryview(news.torque).cast("b").tolist()]
    faults = [_faults(bits) for bits in memoryview(news.fault_bits).cast("h").tolist()]
    verified: list[bool | None] = [each != 0 for each in news.verified]
    return _floats(news.temperature), _floats(news.voltage), torque, verified or [None] * len(torque), faults


def _faults(bits: int) -> list[str]:
    """Names of the bits; none while they are unknown (-1)."""
    if bits < 0:
        return []
    return [FAULT_BITS.get(bit, f"bit_{bit}") for bit in range(15) if bits >> bit & 1]


def _imu(tick: Tick) -> dict[str, object]:
    """Build `Imu` of the interface."""
    numbers = _floats(tick.imu)
    return {key: numbers[first:end] for key, first, end in IMU} | {"age_ms": tick.imu_age * 1e3}
