"""Messages of a daemon for pictures: 24 joints, two buses, and any difference that a test wants."""

from typing import Any

from twind.ctl.dashboard.dashboard_state import DashboardState, MonitorCollector

SIDED = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
NAMES = (
    "head_yaw",
    "head_pitch",
    "waist_yaw",
    "waist_pitch",
    *(f"{side}_{part}" for side in "lr" for part in SIDED),
    *(f"{side}_{part}" for side in "lr" for part in ("shoulder_pitch", "shoulder_roll", "elbow", "wrist")),
)
HOPS = (
    *("total", "request", "reply", "state", "twin"),
    *("received", "gated", "written", "moved", "command"),
)
BOUNDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, None)
REFUSAL = {
    "refusals": [
        {"code": "POS_LIMIT", "message": "l_knee, point 0 (2 s): position 3 rad, bound 2.2 rad"},
        {"code": "SELF_COLLISION", "message": "clearance -0.017 m, bound 0.002 m"},
    ],
    "warnings": [],
    "changes": [],
}


def joint(name: str, place: int, **other: Any) -> dict[str, Any]:
    """One that is as it should be."""
    return {
        "name": name,
        "bus": "upper" if place < 4 else "lower",
        "id": place + 1,
        "position": place / 20.0,
        "velocity": 0.25,
        "effort": -0.5,
        "goal": place / 20.0 + 0.002,
        "simulated": place / 20.0,
        "temperature": 41.0,
        "voltage": 11.9,
        "age_ms": 4.0,
        "heard": True,
        "torque": True,
        "calibrated": True,
        "verified": True,
        "faults": [],
    } | other


def joints(**others: dict[str, Any]) -> list[dict[str, Any]]:
    """All of them; by name what is different."""
    return [joint(name, place, **others.get(name, {})) for place, name in enumerate(NAMES)]


def hop(name: str, place: int) -> dict[str, Any]:
    """Its numbers grow with its place."""
    keys = ("now_ms", "mean_ms", "std_ms", "min_ms", "max_ms", "p50_ms", "p99_ms")
    numbers = {key: place + step / 10.0 for step, key in enumerate(keys)}
    return {"hop": name, **numbers, "violations": 3 if name == "moved" else 0}


def bus(name: str, **other: Any) -> dict[str, Any]:
    """One that works."""
    return {
        "name": name,
        "port": f"/dev/twind/{name}",
        "connected": True,
        "latency_ms": 2.1,
        "latency_p99_ms": 3.4,
        "utilisation": 0.41,
        "exchanges": 1000,
        "errors": 0,
        "warning": None,
    } | other


def status(**other: Any) -> dict[str, Any]:
    """Status of an armed, moving robot with a lease holder."""
    return {
        "version": "1.2.3",
        "robot": "h24",
        "mode": "live",
        "state": "armed",
        "motion": "active",
        "armed": True,
        "inherited": False,
        "hw_connected": True,
        "sim_connected": True,
        "latency_ms": 2.5,
        "latency_avg_ms": 2.4,
        "latency_max_ms": 4.0,
        "violations": 0,
        "skew_ms": 0.3,
        "skew_max_ms": 0.9,
        "lease": {"holder": "uid 1000, pid 4242", "uid": 1000, "expires_in": 0.83},
        "faults": [],
        "buses": [bus("upper"), bus("lower")],
        "loop": loop(),
        "flight": {"span_s": 30.0, "bytes": 4_200_000, "last": None},
    } | other


def loop(**other: Any) -> dict[str, Any]:
    """In time but for a few ticks."""
    counts = (0, 40, 9000, 900, 50, 6, 2, 1, 1, 0, 0)
    return {
        "rate_hz": 100.0,
        "ticks": 10_000,
        "missed": 0,
        "on_time": 1.0,
        "late_p50_us": 42.0,
        "late_p99_us": 83.0,
        "late_max_us": 4100.0,
        "realtime": {"scheduler": "fifo 40"},
        "realtime_denied": [],
        "lateness": [
            {"upper_ms": upper, "count": count} for upper, count in zip(BOUNDS, counts, strict=True)
        ],
    } | other


def event(code: str, text: str, level: str = "info", **annotation: Any) -> dict[str, Any]:
    """Something happened."""
    marked = {"kind": None, "task": None, "success": None, "text": None} | annotation if annotation else None
    return {"level": level, "code": code, "message": text, "findings": [], "annotation": marked}


def receive(watched: MonitorCollector, topic: str, what: Any, now: float) -> None:
    """A message of Monitor."""
    key = {"state": "joints", "verdicts": "verdict", "events": "event"}.get(topic, topic)
    watched.take({"topic": topic, "dropped": 0, key: what}, now)


def robot() -> dict[str, Any]:
    """Fields of the robot file that the picture uses."""
    kind = {"heat": {"warn": 60.0, "settle": 70.0}, "supply": {"warn": 11.1, "settle": 10.5}}
    return {"joints": [{"name": name, "lower": -3.0, "upper": 3.0, "type": kind} for name in NAMES]}


def watched(now: float = 100.0, **other: Any) -> MonitorCollector:
    """A collector with messages of every topic; `joints=`: other joints; other keywords: the status."""
    shown = other.pop("joints", None) or joints()
    one = MonitorCollector()
    one.robot(robot())
    receive(one, "events", event("EPISODE_BEGIN", "pick", kind="begin", task="pick the cup"), now - 95.0)
    receive(one, "events", event("EPISODE_END", "pick", kind="end", success=True), now - 61.0)
    receive(one, "events", event("LATENCY_WARN", "latency 61 ms, bound 50 ms", "warning"), now - 40.0)
    receive(one, "verdicts", REFUSAL, now - 12.0)
    receive(one, "status", status(**other), now - 1.0)
    moved = [each | {"exchanges": each["exchanges"] + 100} for each in status(**other)["buses"]]
    receive(one, "status", status(**other) | {"buses": moved}, now)
    receive(one, "latency", [hop(name, place) for place, name in enumerate(HOPS)], now)
    receive(one, "state", shown, now)
    return one


def view(now: float = 100.0, **other: Any) -> DashboardState:
    """The state of `watched` at `now`."""
    return watched(now, **other).view(now)


TROUBLED = {
    "head_yaw": {"temperature": 63.0},
    "l_knee": {"position": 0.55, "goal": 0.8, "faults": ["overload"]},
    "r_wrist": {"heard": False, "age_ms": 640.0, "position": None, "torque": None, "verified": False},
}


def troubled(now: float = 100.0) -> DashboardState:
    """A fault, a warning of a port, three joints that need a look."""
    message = "l_knee: distance from the goal 0.25 rad, bound 0.2 rad; held where it is"
    slow = "the adapter's latency timer is 16 ms; `sudo setserial /dev/twind/lower low_latency`"
    return view(
        now,
        joints=joints(**TROUBLED),
        state="fault",
        motion="holding",
        faults=[{"code": "FOLLOW_ERR", "message": message}],
        buses=[bus("upper"), bus("lower", errors=17, warning=slow)],
        loop=loop(on_time=0.93, missed=7),
    )
