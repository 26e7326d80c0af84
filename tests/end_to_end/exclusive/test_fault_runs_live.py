"""Fault runs over pseudo-terminals: the daemon and twind-virtual as processes, faults by the orders socket.

What `Monitor` shows is judged by the history of the servos' registers. The servos' clock is CLOCK_MONOTONIC
less the time that their process did not run (`lost`), so a reading is right if the register held it, to the
count, within the exchange and what the two clocks may be apart.
"""

import time
from collections.abc import Iterator
from contextlib import suppress
from threading import Thread
from typing import Any

import numpy as np
import pytest

from tests.support.fault_cases import CASES, FAULT, Case, healing, order
from tests.support.processes import Daemon, Virtual, daemon, patiently, robot
from twind.client import CallError, Client, ClientError
from twind.config.robot_file import load_robot
from twind.virtual.virtual_robot_spec import make_spec

# s that a refresh may lie before the stamp of its reading, and after it on a loaded machine. A reading in
# trouble has 35 bytes of each servo, 4.2 ms at 2 Mbaud, and 2 ms of patience; the rest is scheduling.
EARLY = 0.015
LATE = 0.04
# Which case of one fault of each kind; all others, and all strengths and ids, are run under the fake clock.
# Faults told by the same code do not follow each other: what was told is not told again within a second.
RUN = {
    **{"drop": 2, "noise": 0, "corrupt": 3, "stall": 1, "damage": 0, "cut": 2, "delay": 4},
    **{"brown_out": 0, "power": 0, "silence": 1, "supply": 1, "heat": 1, "freeze": 0, "unplug": 0},
}
SWING = {"head_yaw": 0.5, "head_pitch": 0.3, "r_shoulder_pitch": -0.6, "l_shoulder_pitch": -0.6}


class Watch(Thread):
    """Everything that `Monitor` tells of state and events, until the daemon ends."""

    def __init__(self, running: Daemon) -> None:
        super().__init__(daemon=True)
        self._client = running.client()
        self.states: list[dict[str, Any]] = []
        self.events: list[tuple[float, str]] = []
        self.start()

    def run(self) -> None:
        with suppress(ClientError):
            for news in self._client.stream("Monitor", topics=["state", "events"], rate=100.0):
                if news["topic"] == "state":
                    self.states.append(news)
                else:
                    self.events.append((news["event"]["time"], news["event"]["code"]))


class LiveJudge:
    """Judges the messages of a span of time by what the registers showed."""

    def __init__(self, virtual: Virtual, watch: Watch) -> None:
        self._virtual = virtual
        self._watch = watch
        made = make_spec(load_robot("h24"))
        self._joints = {joint.name: joint for joint in made.robot.joints}
        self._zeros = made.zeros
        self._seen = 0
        self._since = -1.0
        self._before: dict[str, float | None] = {}
        self._lost = self._read_lost()
        self.fresh = self.stale = self.nowhere = 0

    def _read_lost(self) -> float:
        return float(self._virtual.order(query="state")["lost"])

    def _history(self) -> tuple[np.ndarray, np.ndarray, list[int]]:
        times = list[float]()
        rows = list[list[int]]()
        more = True
        ids = list[int]()
        while more:
            page = self._virtual.order(query="history", since=self._since)
            times = times + page["time"]
            rows = rows + page["position"]
            more = page["more"]
            ids = page["ids"]
            self._since = times[-1] if times else self._since
        self._since -= 5.0  # messages that this process took up late are older than the last page
        return np.array(times), np.array(rows), ids

    def judge(self, context: str) -> None:
        """All messages that came since the last time. Raises AssertionError."""
        states = self._watch.states[self._seen :]
        self._seen += len(states)
        lost = self._lost
        self._lost = self._read_lost()
        times, rows, ids = self._history()
        wrong: list[str] = []
        for state in states:
            first = np.searchsorted(times, state["time"] - self._lost - EARLY)
            last = np.searchsorted(times, state["time"] - lost + LATE)
            for joint in state["joints"]:
                shown = rows[first:last, ids.index(joint["id"])] if last > first else np.empty(0)
                wrong += self._one(joint, shown, state["time"])
        assert not wrong, "\n".join([context, *wrong[:10]])

    def _one(self, joint: dict[str, Any], shown: np.ndarray, at: float) -> list[str]:
        name = joint["name"]
        place = joint["position"]
        age = joint["age_ms"]
        before = self._before.get(name, place)
        self._before[name] = place
        if not joint["heard"]:
            self.stale += 1
            changed = before is not None and place != before
            if place is not None and (changed or age is None or age <= 0.0):
                return [f"{at:.3f} {name}: not heard, and yet {before} became {place}, {age} ms old"]
            return []
        if place is None:  # a servo that began anew: nobody knows yet on which turn it is
            self.nowhere += 1
            return []
        self.fresh += 1
        spec = self._joints[name]
        counts = self._zeros[name] + place * spec.sign * spec.ratio * spec.type.ticks_per_turn / (2.0 * np.pi)
        if not (np.abs(shown - counts) < 0.01).any():
            return [f"{at:.3f} {name}: fresh {counts:.2f}, {age} ms old; its register held {shown.tolist()}"]
        return []


def to_and_fro() -> dict[str, Any]:
    """Some joints away from the rest pose and back, again and again."""
    names = list(SWING)
    points = [
        {"positions": [SWING[name] * (k % 2) for name in names], "velocities": [0.0] * len(names)}
        | {"time_from_start": 1.2 * (k + 1)}
        for k in range(1, 40)
    ]
    return {"joint_names": names, "points": points}


@pytest.fixture(scope="module")
def world() -> Iterator[tuple[Virtual, Daemon]]:
    with robot("h24", "--seed", "1") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        virtual.order(fault="record", count=20_000)
        yield virtual, running


def arm_and_move(client: Client, running: Daemon) -> None:
    """Whatever is latched is acknowledged; then armed, and on the way."""
    status = running.status()
    if not status["armed"] or status["faults"] or status["state"] != "armed":
        client.call("EStop", level="cut")
        deadline = time.monotonic() + 30.0
        last = time.monotonic() + 90.0
        while True:
            try:
                client.call("Reset")
                for joint in client.call("GetStatus", joints=True)["joints"]:
                    if joint["faults"]:  # perhaps all of them, one after the other
                        client.call("Reboot", bus=joint["bus"], id=joint["id"])
                        deadline = min(time.monotonic() + 30.0, last)
                client.call("AcquireLease")
                client.call("Arm")
                break
            except CallError as refusal:
                print(f"asked again: {refusal}")
                if time.monotonic() > deadline:
                    raise
            time.sleep(0.05)

    def move() -> None:
        client.call("AcquireLease")
        client.call("SubmitTrajectory", trajectory=to_and_fro())

    patiently(move)


def test_every_monitored_reading_is_correct_or_marked_stale_under_faults(
    world: tuple[Virtual, Daemon],
) -> None:
    virtual, running = world
    watch = Watch(running)
    judge = LiveJudge(virtual, watch)
    with running.client() as client:
        for name, number in RUN.items():
            case: Case = CASES[name][number]
            random = np.random.default_rng([number, *name.encode()])
            given = order(name, case, random)
            arm_and_move(client, running)
            time.sleep(0.4)
            begun = time.monotonic()
            virtual.order(**given)
            time.sleep(min(0.6, random.uniform(*case.lasts)))
            for each in healing(case, given):
                virtual.order(**each)
            time.sleep(0.3)
            judge.judge(str(given))
            told = [at - begun for at, code in watch.events if at >= begun and code in case.alarm]
            print(f"{name}: {given}: {'told after %.0f ms' % (told[0] * 1e3) if told else 'not told'}")
            if case.alarm:
                assert told and min(told) <= 2.0 * case.within + 0.05, (given, told, watch.events[-10:])
            if case.ends == FAULT:
                assert running.status()["faults"], given
    print(f"{judge.fresh} fresh, {judge.stale} stale readings judged, {judge.nowhere} null")
    assert judge.fresh > 10_000
    assert judge.stale > 1_000
