"""State of the robot and the daemon: status, latencies, diagnostics. Pure; standard library, 3.10."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from math import nan
from typing import Any

from twind.client.errors import finding_text
from twind.ros import DIAGNOSTIC_ARRAY, FLOAT, FLOATS, LOG, STRING, encode, stamp

FIELDS = ("now_ms", "mean_ms", "std_ms", "min_ms", "max_ms", "p50_ms", "p99_ms", "violations")
# levels of a DiagnosticStatus
OK = 0
WARN = 1
ERROR = 2
BAD_STATES = ("fault", "estop")
LEVELS = {"debug": 10, "info": 20, "warning": 30, "error": 40}  # of rcl_interfaces/msg/Log

Fields = Mapping[str, Any]


def encode_string(content: Any) -> bytes:
    """Return a String whose text is JSON."""
    return encode(STRING, {"data": json.dumps(content, ensure_ascii=False)})


def latencies(hops: Sequence[Fields]) -> bytes:
    """Topic `latencies`: a row for each hop, a column for each of FIELDS; what is unknown is NaN.

    The labels of the two dimensions name rows and columns.
    """
    rows = [[nan if hop[key] is None else float(hop[key]) for key in FIELDS] for hop in hops]
    names = ", ".join(str(hop["hop"]) for hop in hops)
    wide = len(FIELDS)
    dimensions = [
        {"label": f"hop: {names}", "size": len(rows), "stride": len(rows) * wide},
        {"label": ", ".join(FIELDS), "size": wide, "stride": wide},
    ]
    data = [value for row in rows for value in row]
    return encode(FLOATS, {"layout": {"dim": dimensions, "data_offset": 0}, "data": data})


def command_latency(hops: Sequence[Fields]) -> bytes:
    """Topic `latency`: s from the call of the last command to its first goal; NaN: unknown."""
    values = [hop["now_ms"] for hop in hops if hop["hop"] == "command" and hop["now_ms"] is not None]
    return encode(FLOAT, {"data": values[0] / 1e3 if values else nan})


def log_message(time_ns: int, node: str, level: str, text: str) -> bytes:
    """Message of /rosout. `node`: full name; `level`: of an event of the daemon."""
    name = node.strip("/").replace("/", ".")
    return encode(LOG, {"stamp": stamp(time_ns), "level": LEVELS[level], "name": name, "msg": text})


class Diagnostics:
    """Messages of /diagnostics, one after the other: counts that grew since the last one are a warning."""

    def __init__(self) -> None:
        self._before: dict[str, int] = {}

    def message(self, time_ns: int, bridge: Fields, status: Fields | None, joints: Sequence[Fields]) -> bytes:
        """Build the message; `bridge`: own state; `status`, `joints`: last received; no status: no daemon."""
        rows = [self._bridge(bridge)]
        if status is not None:
            rows += [_robot(status), self._loop(status)]
            rows += [self._bus(bus, status["mode"]) for bus in status["buses"]]
            rows += [_joint(joint, status) for joint in joints]
        for row in rows:
            row["name"] = f"{bridge['node'].lstrip('/')}: {row['name']}"
        header = {"stamp": stamp(time_ns), "frame_id": ""}
        return encode(DIAGNOSTIC_ARRAY, {"header": header, "status": rows})

    def _bridge(self, bridge: Fields) -> dict[str, Any]:
        grew = self._grew("dropped", bridge["dropped"])
        undelivered = self._grew("undelivered", bridge["undelivered"])
        level, message = _first(
            (bridge["error"], ERROR, bridge["error"]),
            (bridge["commands"] and bridge["refuses"], WARN, bridge["refuses"]),
            (grew, WARN, f"{grew} messages of the daemon were lost on the way here"),
            (undelivered, WARN, f"{undelivered} messages were dropped: a reader does not keep up"),
            (True, OK, "the daemon is there"),
        )
        return _row("bridge", "", level, message, bridge)

    def _loop(self, status: Fields) -> dict[str, Any]:
        loop = status["loop"]
        grew = self._grew("missed", loop["missed"])
        message = f"{grew} ticks missed in the last second" if grew else f"{loop['rate_hz']:g} Hz"
        keys = ("rate_hz", "ticks", "missed", "on_time", "late_p50_us", "late_p99_us", "late_max_us")
        values = {key: loop[key] for key in keys} | dict(loop["realtime"])
        return _row("loop", status["robot"], WARN if grew else OK, message, values)

    def _bus(self, bus: Fields, mode: str) -> dict[str, Any]:
        grew = self._grew(f"bus {bus['name']}", bus["errors"])
        level, message = _first(
            (mode == "sim", OK, "not opened in sim"),
            (not bus["connected"], ERROR, "not connected"),
            (bus["warning"], WARN, bus["warning"]),
            (grew, WARN, f"{grew} errors in the last second"),
            (True, OK, "connected"),
        )
        keys = ("port", "latency_ms", "latency_p99_ms", "utilisation", "exchanges", "errors")
        return _row(f"bus {bus['name']}", bus["port"], level, message, {key: bus[key] for key in keys})

    def _grew(self, name: str, count: int) -> int:
        """Return the growth since the last message; a smaller count means that the daemon was restarted."""
        before = self._before.get(name, count)
        self._before[name] = count
        return max(0, count - before)


def _robot(status: Fields) -> dict[str, Any]:
    message = f"{status['mode']}, {status['state']}, {status['motion']}"
    faults = [finding_text(each) for each in status["faults"]]
    level = ERROR if status["state"] in BAD_STATES else WARN if faults else OK
    lease = status["lease"]
    keys = ("version", "mode", "state", "motion", "armed", "inherited", "hw_connected", "latency_ms")
    values = {key: status[key] for key in keys} | {"lease": lease["holder"] if lease else "free"}
    values |= {f"fault {place}": text for place, text in enumerate(faults)}
    return _row("robot", status["robot"], level, "; ".join([message, *faults]), values)


def _joint(joint: Fields, status: Fields) -> dict[str, Any]:
    level, message = _first(
        (status["mode"] == "sim", OK, "simulated"),
        (joint["faults"], ERROR, ", ".join(joint["faults"])),
        (not joint["heard"], WARN, "no reply"),
        (True, OK, "replies"),
    )
    keys = ("age_ms", "temperature", "voltage", "torque", "calibrated", "verified", "bus", "id")
    name = f"{joint['bus']} {joint['id']}"
    return _row(f"joint {joint['name']}", name, level, message, {key: joint[key] for key in keys})


def _first(*cases: tuple[Any, int, Any]) -> tuple[int, str]:
    """Return level and message of the first case whose condition holds."""
    return next((level, str(message)) for condition, level, message in cases if condition)


def _row(name: str, hardware: str, level: int, message: str, values: Fields) -> dict[str, Any]:
    rows = [{"key": str(key), "value": text} for key, text in _texts(values)]
    return {"level": level, "name": name, "message": message, "hardware_id": hardware, "values": rows}


def _texts(values: Fields) -> Iterator[tuple[str, str]]:
    """Yield each key with its value as text; an unknown value is "unknown", never a zero."""
    for key, value in values.items():
        if value is None:
            yield key, "unknown"
        elif isinstance(value, bool):
            yield key, "yes" if value else "no"
        else:
            yield key, f"{value:.6g}" if isinstance(value, float) else str(value)
