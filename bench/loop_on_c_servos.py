"""`loop.*` and `front.rss` on servos in C: CPU, missed ticks and memory, beside the base commit."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from bench.base_commit import SourceTree, base_tree, own_tree
from bench.c_servos import on_c_servos
from bench.daemon import await_state, require_armed, scratch
from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    cpu_of,
    interleaved,
    medians,
    spread,
)
from bench.loop import four_buses
from bench.motion import kept_moving
from bench.stalls import TickCount, count_ticks, sentinel
from twind.client import Refused

SPAN = 5.0  # s of each window
MISSED_SPAN = 60.0  # s
MEMORY_SPAN = 60.0  # s
MEMORY = ("VmRSS", "VmLck")  # entries of /proc/PID/status
ATTEMPTS = 3  # of one window
SETTLE = 1.0  # s after the motion began


@dataclass(frozen=True, slots=True)
class CpuWindow:
    """Use of both processes in one window."""

    loop: float  # % of a core
    front: float  # % of a core
    ticks: int
    missed: int
    policy: str


def _taking(robot_of: Callable[[SourceTree, Path], Path], rate_hz: int, key: str) -> Measurement:
    """Measurement of the CPU share on the robot that `robot_of` gives for a tree."""

    def take() -> Mapping[str, MeasuredFigure]:
        with scratch() as folder, base_tree(folder) as base:
            windows: dict[str, list[CpuWindow]] = {}

            def taking(tree: SourceTree) -> Callable[[], float]:
                def take_round() -> float:
                    window = _attempted(tree, folder, robot_of(tree, folder), rate_hz)
                    windows.setdefault(tree.name, []).append(window)
                    return window.loop

                return take_round

            own = own_tree()
            rounds = interleaved(ROUNDS, {tree.name: taking(tree) for tree in (own, base)})
        return {key: _figure(own.name, base.name, rounds, windows)}

    aims = {"loop.cpu_c_servos": "≤ 10, ≤ 0.4 × 2d1dfd9", "loop.cpu_c_servos_four_100hz": "≤ 12"}
    return Measurement({key: FigureSpec("% of a core", aims.get(key, "≤ 20"))}, take)


def _attempted(tree: SourceTree, folder: Path, robot: Path, rate_hz: int) -> CpuWindow:
    """A window of an armed robot; tried again where a busy machine ended the motion."""
    reasons = []
    for _ in range(ATTEMPTS):
        try:
            return _window(tree, folder, robot, rate_hz)
        except (Refused, MeasurementUnavailable) as reason:
            reasons.append(str(reason))
    raise MeasurementUnavailable(f"{tree.name}: {ATTEMPTS} attempts ended: {reasons[-1]}")


def _window(tree: SourceTree, folder: Path, robot: Path, rate_hz: int) -> CpuWindow:
    """One start, arming and window of `tree`."""
    with on_c_servos(tree, folder, robot, "--rate", str(rate_hz)) as daemon, kept_moving(daemon):
        await_state(daemon, "armed")
        pids = (daemon.pid, daemon.front)
        with daemon.client() as client:
            time.sleep(SETTLE)
            first = client.call("GetStatus")["status"]["loop"]
            since = time.monotonic()
            before = [cpu_of(pid) for pid in pids]
            time.sleep(SPAN)
            span = time.monotonic() - since
            loop, front = (
                (cpu_of(pid) - start) / span * 100.0 for pid, start in zip(pids, before, strict=True)
            )
            last = client.call("GetStatus")["status"]["loop"]
        require_armed(daemon)
    ticks, missed = (last[name] - first[name] for name in ("ticks", "missed"))
    return CpuWindow(loop, front, ticks, missed, last["realtime"]["scheduler"])


def _figure(
    own: str, base: str, rounds: Mapping[str, list[float]], windows: Mapping[str, list[CpuWindow]]
) -> MeasuredFigure:
    """Median of the loop's share; the rest in the note."""
    middle = medians(rounds)
    ours = windows[own]
    per_tick = medians(
        {name: [row.loop * 1e4 * SPAN / max(1, row.ticks) for row in rows] for name, rows in windows.items()}
    )
    front = medians({"": [row.front for row in ours]})[""]
    missed = {name: sum(row.missed for row in rows) for name, rows in windows.items()}
    note = f"loop's process, all joints moving; {per_tick[own]:.0f} µs a tick, base {per_tick[base]:.0f}; "
    note += f"front {front:.2f} %; missed ticks {missed[own]}, base {missed[base]}; "
    note += f"policy {ours[-1].policy}; {spread(rounds[own], '%')}"
    return MeasuredFigure(middle[own], note, {f"base {base}": middle[base]})


def _h24(tree: SourceTree, _: Path) -> Path:
    return tree.built_in_robot("h24")


def _four(tree: SourceTree, folder: Path) -> Path:
    path = folder / f"h24-four-{tree.name.replace(' ', '-')}.yaml"
    return four_buses(path, tree.built_in_robot("h24"))


def take_missed() -> Mapping[str, MeasuredFigure]:
    """Ticks that did not begin in their own period: 500 Hz, four buses of six servos, both trees."""
    with scratch() as folder, base_tree(folder) as base:
        counts: dict[str, TickCount] = {}
        for tree in (own_tree(), base):
            robot = _four(tree, folder)
            with (
                sentinel(folder, 0.002) as log,
                on_c_servos(tree, folder, robot, "--rate", "500") as daemon,
                kept_moving(daemon),
            ):
                await_state(daemon, "armed")
                counts[tree.name] = count_ticks(daemon, log, MISSED_SPAN)
                require_armed(daemon)
                seen = log.note()
    note = f"{'; '.join(f'{name}: {count.note()}' for name, count in counts.items())}; {seen}"
    peers = {f"base {base.name}": counts[base.name].share}
    return {"loop.missed_500hz": MeasuredFigure(counts[own_tree().name].share, note, peers)}


def take_memory() -> Mapping[str, MeasuredFigure]:
    """Resident memory of both processes after a minute armed and moving, of both trees."""
    sizes: dict[str, dict[str, float]] = {}
    with scratch() as folder, base_tree(folder) as base:
        for tree in (own_tree(), base):
            with on_c_servos(tree, folder, _h24(tree, folder)) as daemon, kept_moving(daemon):
                await_state(daemon, "armed")
                time.sleep(MEMORY_SPAN)
                require_armed(daemon)
                pids = {"loop": daemon.pid, "front": daemon.front}
                sizes[tree.name] = {
                    f"{name}.{key}": _megabytes(pid, key) for name, pid in pids.items() for key in MEMORY
                }
    own = sizes[own_tree().name]
    return {
        f"{name}.rss": MeasuredFigure(
            own[f"{name}.VmRSS"],
            f"after {MEMORY_SPAN:g} s armed and moving; locked {own[f'{name}.VmLck']:.0f} MB",
            {f"base {base.name}": sizes[base.name][f"{name}.VmRSS"]},
        )
        for name in ("loop", "front")
    }


def _megabytes(pid: int, key: str) -> float:
    """Entry of /proc/PID/status, MB."""
    rows = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(row for row in rows if row.startswith(key)).split()[1]) / 1024.0


MEASUREMENTS = (
    _taking(_h24, 100, "loop.cpu_c_servos"),
    _taking(_four, 100, "loop.cpu_c_servos_four_100hz"),
    _taking(_four, 200, "loop.cpu_c_servos_four_200hz"),
    Measurement({"loop.missed_500hz": FigureSpec("%", "< 0.1")}, take_missed),
    Measurement({"loop.rss": FigureSpec("MB", "≤ 110"), "front.rss": FigureSpec("MB", "≤ 50")}, take_memory),
)
