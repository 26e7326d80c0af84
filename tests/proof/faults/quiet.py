"""A fault-free life: built-in motions, arming, idling. Whatever is told of it is a false alarm."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.proof.faults.tap import Tap
from tests.support.daemon_rig import Rig
from twind import link
from twind.command_line.trajectory_files import read_trajectory
from twind.robot.modes import RobotState
from twind.robot.trajectory import Trajectory

FINE = {"debug", "info"}


def quiet(hours: float, seed: int = 0) -> dict[str, Any]:
    """So long under the fake clock; what it came to, and under `wrong` what must not be."""
    rig = Rig()
    random = np.random.default_rng([seed, 99])
    tap = Tap(rig)
    wrong = list[str]()
    played = 0
    begun = time.process_time()
    motions = _motions(rig)
    until = rig.clock.now() + 3600.0 * hours
    _ready(rig)
    while rig.clock.now() < until and not wrong:
        choice = random.random()
        if choice < 0.08:
            played += _rest(rig, float(random.uniform(1.0, 40.0)), wrong)
        elif choice < 0.2:
            for _ in range(round(random.uniform(0.5, 20.0) / 0.1)):
                rig.ticks(10)
        else:
            played += _play(rig, motions[int(random.integers(len(motions)))], wrong)
        tap.look()
        wrong += _reports(rig) + tap.wrong[:5]
        rig.news.clear()
    missed = rig.loop.figures.missed
    state = rig.loop.condition.state.value
    rig.close()
    if missed:
        wrong.append(f"{missed} ticks missed")
    cpu = time.process_time() - begun
    return {"hours": hours, "motions": played, "state": state, "cpu_s": round(cpu, 1), "wrong": wrong}


def _motions(rig: Rig) -> list[Any]:
    found = []
    for path in sorted((rig.robot.path.parent / "motions").glob("*.json")):
        found.append(_path(rig, path))
    assert found
    return found


def _path(rig: Rig, file: Path) -> Trajectory:
    """A motion file as it goes to the gate; joints that it does not name keep what they do."""
    described = read_trajectory(file)
    columns = [rig.names.index(name) for name in described["joint_names"]]
    points = described["points"]
    position = np.tile(rig.loop.robot.rest, (len(points), 1))
    velocity = np.zeros_like(position)
    position[:, columns] = [point["positions"] for point in points]
    if "velocities" in points[0]:
        velocity[:, columns] = [point["velocities"] for point in points]
    commanded = np.zeros(len(rig.names), np.bool_)
    commanded[columns] = True
    times = [point["time_from_start"] for point in points]
    return Trajectory(np.array(times, np.float64), position, commanded, velocity)


def _ready(rig: Rig) -> None:
    rig.connect()
    rig.seconds(0.5)
    rig.call(link.AcquireLease)
    reply = rig.call(link.Arm)
    assert reply.error is None, reply


def _play(rig: Rig, path: Any, wrong: list[str]) -> int:
    rig.lease()
    ticket = rig.submit(path, more=True, policy="retime")
    for _ in range(3000):
        rig.ticks(1)
        last = rig.replies(ticket)[-1:]
        if last and not last[0].continues:
            phase = last[0].parameters.get("phase")
            if phase != "succeeded":
                wrong.append(f"a motion ended: {last[0]}"[:300])
            return 1
    wrong.append("a motion did not end within 30 s")
    return 0


def _rest(rig: Rig, seconds: float, wrong: list[str]) -> int:
    for kind in (link.Disarm, link.AcquireLease, link.Arm):
        reply = rig.call(kind, ticks=900)
        if reply.error is not None:
            wrong.append(f"{kind.__name__}: {reply}"[:300])
        if kind is link.Disarm:
            for _ in range(round(seconds / 0.1)):
                rig.ticks(10)
    if rig.loop.condition.state is not RobotState.ARMED:
        wrong.append(f"state {rig.loop.condition.state.value}")
    return 0


def _reports(rig: Rig) -> list[str]:
    return [
        f"{event.time:.3f} {event.code} {event.message}" for event in rig.events() if event.level not in FINE
    ]
