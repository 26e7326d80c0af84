"""Messages of a daemon to `twindctl metrics`, written by hand: two joints, one bus."""

from typing import Any

Fields = dict[str, Any]


def bucket(upper: float | None, count: int) -> Fields:
    return {"upper_ms": upper, "count": count}


def joint(name: str, **other: Any) -> Fields:
    said: Fields = {
        "name": name,
        "position": 0.5,
        "velocity": 0.25,
        "effort": None,
        "goal": 0.75,
        "simulated": 0.6,
        "temperature": 41.0,
        "voltage": 12.1,
        "age_ms": 12.0,
        "heard": True,
        "torque": True,
        "calibrated": True,
        "verified": None,
        "faults": [],
    }
    return said | other


def status(ticks: int = 1000, missed: int = 0, time: float = 60.0, **other: Any) -> Fields:
    """A message of topic status: a loop of 100 Hz."""
    loop = {"rate_hz": 100.0, "ticks": ticks, "missed": missed, "on_time": 0.99}
    loop |= {"realtime": {"cpu": "any", "memory": "x"}, "realtime_denied": ["memory"]}
    loop |= {"lateness": [bucket(0.1, 900), bucket(1.0, 90), bucket(None, 10)], "lateness_sum_ms": 250.0}
    bus = {"name": "main", "connected": True, "utilisation": 0.4, "latency_ms": 2.5}
    said: Fields = {
        "version": "1.2.3",
        "robot": "h24",
        "mode": "live",
        "state": "armed",
        "motion": "holding",
        "armed": True,
        "inherited": False,
        "hw_connected": True,
        "latency_ms": 12.5,
        "skew_ms": None,
        "lease": {"holder": "uid 0, pid 1", "uid": 0, "expires_in": 1.0},
        "faults": [{"code": "STATE_STALE", "joint": "b", "message": "old"}],
        "buses": [bus | {"exchanges": ticks, "errors": 3}],
        "loop": loop,
        "flight": {"span_s": 30.0, "bytes": 4096, "last": None},
    }
    return {"topic": "status", "time": time, "dropped": 0, "status": said | other}


def state(*joints: Fields) -> Fields:
    said = joints or (joint("a"), joint("b", heard=False, faults=["overload"], age_ms=None))
    return {"topic": "state", "time": 60.0, "dropped": 0, "joints": list(said), "skew_ms": None}


def latency(histogram: list[Fields] | None, total: float | None = None) -> Fields:
    hop = {"hop": "reply", "violations": 2, "histogram": histogram, "histogram_sum_ms": total}
    return {"topic": "latency", "time": 60.0, "dropped": 0, "latency": [hop]}


def verdict(*codes: str) -> Fields:
    refusals = [{"code": code, "message": ""} for code in codes]
    return {"topic": "verdicts", "time": 60.0, "dropped": 0, "verdict": {"refusals": refusals}}


def event(code: str, dropped: int = 0) -> Fields:
    return {"topic": "events", "time": 60.0, "dropped": dropped, "event": {"level": "error", "code": code}}
