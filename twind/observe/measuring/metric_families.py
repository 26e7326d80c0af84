"""Metric families of the daemon: names, units, labels. Pure; `prometheus_client` writes them out.

Labels are joints, buses, hops, codes and states: names of the robot file or of the interface, so their
number is bounded. The lease holder and the text of messages are no labels.
"""

from collections.abc import Iterable, Iterator, Sequence
from enum import StrEnum
from math import inf

from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)

from twind.observe.measuring.metrics_ledger import Buckets, DaemonMetrics, Fields
from twind.robot.modes import Mode, Motion, RobotState

MS = 1e-3  # s
Rows = Sequence[tuple[tuple[str, ...], Fields]]  # label values, fields

# name, its unit, the field, factor to the unit, what it is
JOINT = (
    ("position_radians", "radians", "position", 1.0, "Measured position; in mode sim the simulated one."),
    ("velocity_radians_per_second", "radians_per_second", "velocity", 1.0, "Measured velocity."),
    ("effort_newton_meters", "newton_meters", "effort", 1.0, "Measured effort."),
    ("external_newton_meters", "newton_meters", "external_nm", 1.0, "Torque from outside, estimated."),
    ("goal_radians", "radians", "goal", 1.0, "Commanded position; absent while nothing is commanded."),
    ("simulated_radians", "radians", "simulated", 1.0, "Position of the simulation."),
    ("temperature_celsius", "celsius", "temperature", 1.0, "Temperature of the actuator."),
    ("voltage_volts", "volts", "voltage", 1.0, "Supply at the actuator."),
    ("age_seconds", "seconds", "age_ms", MS, "Since the actuator last answered; absent: it never did."),
    ("heard", "", "heard", 1.0, "1: it answered in the last exchange."),
    ("torque_on", "", "torque", 1.0, "1: torque is on, as read back; absent: unknown."),
    ("calibrated", "", "calibrated", 1.0, "1: it has a calibration."),
    ("verified", "", "verified", 1.0, "1: its device and turn are known to be those of the calibration."),
)  # fmt: skip
STATUS = (
    ("armed", "", "armed", 1.0, "1: torque is ours."),
    ("torque_inherited", "", "inherited", 1.0, "1: torque was found on at start and is not ours yet."),
    ("hardware_connected", "", "hw_connected", 1.0, "1: a device on a bus answers."),
    ("state_latency_seconds", "seconds", "latency_ms", MS, "Age of the newest state + its round trip."),
    ("bus_skew_seconds", "seconds", "skew_ms", MS, "Between the first and the last bus of one exchange."),
)
GAP = (
    ("spread_ratio", "ratio", "nrmse_spread", 1.0, "Error of the simulation / spread of the measured."),
    ("unexplained_ratio", "ratio", "unexplained", 1.0, "The same / rms of delayed goal less measured."),
)
LOOP_GAUGES = (
    ("loop_rate_hertz", "hertz", "rate_hz", 1.0, "Ticks a second, as set."),
    ("loop_on_time_ratio", "ratio", "on_time", 1.0, "Share of the last 100 ticks that began on time."),
)
LOOP_COUNTS = (
    ("loop_ticks", "ticks", "Ticks of the loop."),
    ("loop_missed_ticks", "missed", "Ticks that were left out, because one before them took too long."),
)
BUS_GAUGES = (
    ("bus_connected", "", "connected", 1.0, "1: the port is open and answers."),
    ("bus_utilisation_ratio", "ratio", "utilisation", 1.0, "Share of the tick in which the wire was busy."),
    ("bus_latency_seconds", "seconds", "latency_ms", MS, "Request to last byte of the last exchange."),
)
BUS_COUNTS = (
    ("bus_exchanges", "exchanges", "Exchanges with the bus."),
    ("bus_errors", "errors", "Exchanges in which an answer was missing or wrong."),
)
FLIGHT = (
    ("flight_span_seconds", "seconds", "span_s", 1.0, "How far back the flight recorder reaches."),
    ("flight_size_bytes", "bytes", "bytes", 1.0, "What the flight recorder holds."),
)

# Of all streamers together: a label of their names would be one for each spool that ever was.
STREAMS = (
    ("stream_sent_messages", "messages", "sent", 1.0, "Taken by endpoints, of the streamers that are there."),
    ("stream_waiting_messages", "messages", "waiting", 1.0, "Wait in their spools."),
    ("stream_dropped_messages", "messages", "dropped", 1.0, "Dropped: too much, too old, or no disk."),
    ("stream_dead_messages", "messages", "dead", 1.0, "Dead letters: endpoints will not have them."),
)


def families(news: DaemonMetrics | None) -> Iterator[Metric]:
    """Everything there is to say. None, or a daemon that is not there: `twind_up 0` and nothing else."""
    yield GaugeMetricFamily("twind_up", "1: the daemon is there and talks.", value=float(news is not None))
    if news is None:
        return
    status = news.status
    yield _plain("news_age_seconds", "seconds", news.age, "Since the daemon's last message.")
    yield InfoMetricFamily("twind", "Which daemon.", {key: str(status[key]) for key in ("version", "robot")})
    yield _states("mode", status["mode"], Mode, "Where commands go.")
    yield _states("state", status["state"], RobotState, "The robot and its bus.")
    yield _states("motion", status["motion"], Motion, "What the target of commands does.")
    yield from _gauges(STATUS, [((), status)], ())
    yield _plain("lease_held", "", float(status["lease"] is not None), "1: a client holds the lease.")
    yield from _faults(status["faults"])
    yield from _loop(news)
    yield from _buses(news)
    yield from _gauges(JOINT, [((each["name"],), each) for each in news.joints], ("joint",), "joint_")
    yield from _gap(status.get("gap"))
    joint_faults = [(joint["name"], fault) for joint in news.joints for fault in joint["faults"]]
    text = "1 for each hardware error that its actuator reports."
    yield _ones("joint_fault", text, ("joint", "fault"), joint_faults)
    yield from _latency(news)
    yield from _gauges(FLIGHT, [((), status.get("flight") or {})], ())
    yield from _gauges(STREAMS, _together(status.get("streams") or ()), ())
    yield from _counted(news)


def _gap(gap: Fields | None) -> Iterator[Metric]:
    """A family for each norm; joints that moved too little have no sample."""
    joints: Sequence[Fields] = () if gap is None else gap["joints"]
    for quantity in ("position", "velocity", "effort"):
        rows: Rows = [((each["joint"],), each[quantity]) for each in joints if each[quantity] is not None]
        yield from _gauges(GAP, rows, ("joint",), f"joint_gap_{quantity}_")


def _together(streams: Sequence[Fields]) -> Rows:
    """Sums over all streamers; empty without streamers."""
    sums = {key: sum(each[key] for each in streams) for _, _, key, _, _ in STREAMS}
    return [((), sums)] if streams else []


def _plain(name: str, unit: str, value: float, text: str) -> Metric:
    return GaugeMetricFamily(f"twind_{name}", text, value=value, unit=unit)


def _gauges(
    table: Iterable[tuple[str, str, str, float, str]], rows: Rows, labels: Sequence[str], prefix: str = ""
) -> Iterator[Metric]:
    """A family for each line of the table; what is unknown has no sample."""
    for name, unit, key, factor, text in table:
        family = GaugeMetricFamily(f"twind_{prefix}{name}", text, labels=labels, unit=unit)
        for values, fields in rows:
            if fields.get(key) is not None:
                family.add_metric(values, factor * float(fields[key]))
        yield family


def _counters(
    table: Iterable[tuple[str, str, str]], rows: Rows, labels: Sequence[str], created: float
) -> Iterator[Metric]:
    for name, key, text in table:
        family = CounterMetricFamily(f"twind_{name}", text, labels=labels)
        for values, fields in rows:
            family.add_metric(values, fields[key], created)
        yield family


def _states(name: str, now: str, known: type[StrEnum], text: str) -> Metric:
    """One of several; a state that a newer daemon knows comes in addition."""
    words = {str(each) for each in known} | {now}
    return StateSetMetricFamily(f"twind_{name}", text, {word: word == now for word in words})


def _faults(faults: Sequence[Fields]) -> Iterator[Metric]:
    yield _plain("faults", "", float(len(faults)), "What is latched, or keeps from arming.")
    found = sorted({(each["code"], each["joint"] or "") for each in faults})
    yield _ones("fault", "1 for each such thing.", ("code", "joint"), found)


def _loop(news: DaemonMetrics) -> Iterator[Metric]:
    rows: Rows = [((), news.status["loop"])]
    yield from _gauges(LOOP_GAUGES, rows, ())
    yield from _counters(LOOP_COUNTS, rows, (), news.began)
    family = HistogramMetricFamily(
        "twind_loop_lateness_seconds", "How late ticks began, of the whole run.", labels=(), unit="seconds"
    )
    if news.lateness is not None:
        _histogram(family, {}, news.lateness, news.status["loop"].get("lateness_sum_ms"), news.began)
    yield family
    granted = GaugeMetricFamily("twind_realtime_granted", "1: got as asked for.", labels=("what",))
    denied = news.status["loop"].get("realtime_denied")
    for what in (
        sorted(news.status["loop"]["realtime"]) if denied is not None else ()
    ):  # None: an older daemon
        granted.add_metric((what,), float(what not in denied))
    yield granted


def _buses(news: DaemonMetrics) -> Iterator[Metric]:
    rows: Rows = [((each["name"],), each) for each in news.status["buses"]]
    yield from _gauges(BUS_GAUGES, rows, ("bus",))
    yield from _counters(BUS_COUNTS, rows, ("bus",), news.began)


def _ones(name: str, text: str, labels: Sequence[str], found: Iterable[Sequence[str]]) -> Metric:
    """A family with the value 1 for each combination of label values that was found."""
    family = GaugeMetricFamily(f"twind_{name}", text, labels=labels)
    for values in found:
        family.add_metric(values, 1.0)
    return family


def _latency(news: DaemonMetrics) -> Iterator[Metric]:
    family = HistogramMetricFamily(
        "twind_latency_seconds", "Time taken by each hop, of the whole run.", labels=("hop",), unit="seconds"
    )
    violations = GaugeMetricFamily(
        "twind_latency_violations", "Above the threshold, of the last 100 values.", labels=("hop",)
    )
    for hop, fields in news.latencies.items():
        violations.add_metric((hop,), fields["violations"])
        if fields["histogram"] is not None:
            total = fields.get("histogram_sum_ms")
            _histogram(family, {"hop": hop}, fields["histogram"], total, news.began)
    yield family
    yield violations


def _histogram(
    family: HistogramMetricFamily,
    labels: dict[str, str],
    buckets: Buckets,
    total_ms: float | None,
    created: float,
) -> None:
    """Buckets of the interface, each without those below it, as buckets that hold all that is below."""
    seen = 0
    below = []
    for bucket in buckets:
        seen += bucket["count"]
        upper = inf if bucket["upper_ms"] is None else bucket["upper_ms"] * MS
        below.append(("+Inf" if upper == inf else str(float(f"{upper:.9g}")), seen))
    if below[-1][0] != "+Inf":
        below.append(("+Inf", seen))
    family.add_metric(list(labels.values()), below, None if total_ms is None else total_ms * MS)
    family.add_sample(f"{family.name}_created", labels, created)


def _counted(news: DaemonMetrics) -> Iterator[Metric]:
    """Counters of this process since its start."""
    counted = news.counted
    for name, label, counts, text in (
        ("refusals", "code", counted.refusals, "Trajectories and setpoints refused, by reason."),
        ("verdicts", "verdict", counted.verdicts, "Trajectories judged, and setpoints that were refused."),
        ("events", "code", counted.events, "Events by code."),
    ):
        rows: Rows = [((value,), {"count": count}) for value, count in sorted(counts.items())]
        yield from _counters([(name, "count", text)], rows, (label,), counted.since)
    text = "Messages that this exporter was too slow for."
    lost: Rows = [((), {"count": counted.lost})]
    yield from _counters([("exporter_lost_messages", "count", text)], lost, (), counted.since)
