"""`loop.*` of real time: how late ticks begin, alone and beside a busy client, and what the daemon costs."""

import time
from collections.abc import Mapping
from pathlib import Path

import yaml

from bench.daemon import BenchDaemon, Cyclictest, StatusPoller, await_state, live, scratch
from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    cpu_of,
    interleaved,
    medians,
    quantile,
    spread,
)
from bench.lateness_log import LatenessLog
from bench.motion import kept_moving
from twind.config.robot_file import load_robot

# s of each window
LATE_ROUNDS = 10
LATE_SPAN = 4.0
SHARE_SPAN = 4.0  # s
MISSED_SPAN = 60.0  # s
NO_PEER = "no cyclictest: it is not installed (Debian package rt-tests)"


def take_late() -> Mapping[str, MeasuredFigure]:
    """p99 of the lateness of ticks, idle and busy, each beside `cyclictest` in the same seconds."""
    with scratch() as folder:
        record = folder / "lateness"
        with live(folder, command=("-m", "bench.lateness_log", str(record))) as daemon:
            return _late(daemon, LatenessLog(record))


def _late(daemon: BenchDaemon, record: LatenessLog) -> dict[str, MeasuredFigure]:
    with daemon.client() as client:
        policy = client.call("GetStatus")["status"]["loop"]["realtime"]["scheduler"]
    peer = Cyclictest(policy)
    asker = StatusPoller(daemon)
    theirs: dict[str, list[float]] = {"idle": [], "busy": []}
    asked: list[float] = []

    def window(kind: str) -> float:
        start = len(record)
        peer.start(LATE_SPAN)
        if kind == "busy":
            asked.append(asker.flat_out(LATE_SPAN) / LATE_SPAN)
        else:
            time.sleep(LATE_SPAN)
        late = record.since(start)
        their = peer.p99()
        if their is not None:
            theirs[kind].append(their)
        return quantile(late, 0.99) * 1e6

    found = interleaved(LATE_ROUNDS, {"idle": lambda: window("idle"), "busy": lambda: window("busy")})
    asker.close()
    middle = medians(found)
    their_middle = medians({kind: rows for kind, rows in theirs.items() if rows})
    how = f"live, 24 virtual servos, not armed; policy {policy}, cyclictest the same in the same seconds"
    if not their_middle:
        how = f"live, 24 virtual servos, not armed; policy {policy}; {NO_PEER}"
    notes = {
        "idle": f"{how}; {spread(found['idle'], 'µs')}",
        "busy": f"{how}; {medians({'': asked})['']:.0f} calls/s; {spread(found['busy'], 'µs')}",
    }
    figures = {
        f"loop.late_p99_{kind}": MeasuredFigure(
            middle[kind], notes[kind], {"cyclictest": their_middle.get(kind)}
        )
        for kind in ("idle", "busy")
    }
    busy = figures["loop.late_p99_busy"]
    figures["loop.late_p99_busy"] = MeasuredFigure(
        busy.value, busy.note, {**busy.peers, "idle": middle["idle"]}
    )
    return figures


def take_share() -> Mapping[str, MeasuredFigure]:
    """CPU of loop and front together over seconds of real time, in % of a core."""
    with scratch() as folder, live(folder) as daemon:
        resting = shares(daemon)
        with kept_moving(daemon):
            await_state(daemon, "armed")
            moving = shares(daemon)
    middle = medians(moving)
    still = medians(resting)
    note = (
        f"live, armed, 24 joints moving: loop {middle['loop']:.2f}, front {middle['front']:.2f}; "
        f"not armed: {still['both']:.2f}; {spread(moving['both'], '%')}"
    )
    return {"loop.cpu_share_100hz": MeasuredFigure(middle["both"], note)}


def shares(daemon: BenchDaemon) -> dict[str, list[float]]:
    """% of a core of each process, a round each."""
    pids = {"loop": daemon.pid, "front": daemon.front}
    found: dict[str, list[float]] = {"loop": [], "front": [], "both": []}
    for _ in range(ROUNDS):
        since = time.monotonic()
        before = {name: cpu_of(pid) for name, pid in pids.items()}
        time.sleep(SHARE_SPAN)
        span = time.monotonic() - since
        used = {name: (cpu_of(pid) - before[name]) / span * 100.0 for name, pid in pids.items()}
        for name, share in {**used, "both": sum(used.values())}.items():
            found[name].append(share)
    if not Path(f"/proc/{pids['front']}").exists():
        raise MeasurementUnavailable("the front was started anew while it was measured")
    return found


def take_missed() -> Mapping[str, MeasuredFigure]:
    """Ticks that did not begin in their own period: 500 Hz, four buses of six servos, armed and moving."""
    with scratch() as folder:
        return {
            "loop.missed_500hz_python": missed(folder, four_buses(folder / "h24-four.yaml"), 500, MISSED_SPAN)
        }


def missed(folder: Path, robot: Path, rate_hz: int, span: float, *, apart: bool = False) -> MeasuredFigure:
    """Share (%) of ticks that did not begin in their own period, over `span` s, armed and moving.

    `apart`: the actuators of each bus are a process of their own.
    """
    rate = ("--rate", str(rate_hz))
    with live(folder, *rate, robot=str(robot), apart=apart) as daemon, kept_moving(daemon):
        await_state(daemon, "armed")
        with daemon.client() as client:
            first = client.call("GetStatus")["status"]
            time.sleep(span)
            last = client.call("GetStatus")["status"]
    ticks, late = (last["loop"][key] - first["loop"][key] for key in ("ticks", "missed"))
    errors = sum(bus["errors"] for bus in last["buses"]) - sum(bus["errors"] for bus in first["buses"])
    note = f"{late} of {ticks + late} in {span:g} s, {errors} readings with a silent actuator, "
    actuators = "a process for each bus, each joint for itself" if apart else "one process for all"
    note += f"armed and moving; policy {last['loop']['realtime']['scheduler']}; actuators: {actuators}"
    return MeasuredFigure(100.0 * late / (ticks + late), note)


def four_buses(path: Path, built_in: Path | None = None) -> Path:
    """The body of h24 on four buses at 3 Mbaud, six servos each, adapters without a latency timer."""
    built_in = built_in or load_robot("h24").path
    robot = yaml.safe_load(built_in.read_text())
    robot["name"] = "h24-four"
    robot["model"]["mjcf"] = str(built_in.parent / robot["model"]["mjcf"])
    bus = {"kind": "dynamixel2", "baud": 3_000_000, "latency_timer_ms": 0}
    robot["buses"] = {name: dict(bus) for name in "abcd"}
    robot["defaults"].pop("bus", None)
    for place, joint in enumerate(robot["joints"].values()):
        joint |= {"bus": "abcd"[place // 6], "id": place % 6 + 1}
    path.write_text(yaml.safe_dump(robot, sort_keys=False))
    return path


MEASUREMENTS = (
    Measurement(
        {
            "loop.late_p99_idle": FigureSpec("µs"),
            "loop.late_p99_busy": FigureSpec("µs", "≤ 2 × cyclictest, ≤ 1.5 × idle"),
        },
        take_late,
    ),
    Measurement({"loop.cpu_share_100hz": FigureSpec("% of a core", "≤ 8")}, take_share),
    Measurement({"loop.missed_500hz_python": FigureSpec("%")}, take_missed),
)
