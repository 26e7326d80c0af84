"""SIGKILL of the real daemon at a random phase: `make kills N=100`; a few by
`tests/end_to_end/exclusive/test_sigkill_daemon.py`.

Real processes over real pseudo-terminals. After each kill: the watchdog of every servo under torque trips by
its own clock, a new daemon is disarmed, inherits and moves nothing, then arms and runs. What was acknowledged
before is told to its end, or ends with the connection; what was told as done is true of the servos.
"""

import argparse
import os
import random
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import Any

from tests.support.processes import BUSY, Daemon, Virtual, robot, until
from twind.client import Client, ClientError, Disconnected, NoDaemon, Refused

TRIP = 0.120  # s from the last packet, by the servo's own clock (W11)
COUNTS = 2  # that a joint may move where nothing may move (X5)
ARMED = 20  # counts that a joint may move when arming makes its loaded position the goal
NEAR = 40  # counts between the goal of a motion that succeeded and the joint, with its load
# who moves, and its place among the servos
JOINT = "head_pitch"
PLACE = 1
TICKS_PER_RAD = 4096 / 6.283185307179586
PATIENCE = 60.0  # s that a machine may be too busy to arm or to move
PHASES = ("holding", "moving", "streaming", "arming", "settling", "stopping", "disarmed")


@dataclass
class Kill:
    """One kill, and what was seen of it."""

    phase: str
    delay: float  # s after the phase was reached
    trips: list[float] = field(default_factory=list)  # s, by the servos' clocks
    torque: int = 0  # servos whose torque was on afterwards
    moved: float = 0.0  # counts, most of any joint, until the new daemon had been up for a while
    back: float = 0.0  # s until the new daemon was connected
    acknowledged: int = 0
    told: int = 0  # ... whose end was told
    cut: int = 0  # ... whose connection ended with the daemon


class Kills:
    """A virtual robot and one daemon after the other."""

    def __init__(self, virtual: Virtual, folder: Path, seed: int) -> None:
        self.virtual = virtual
        self.folder = folder
        self.random = random.Random(seed)
        self.middle = self.places()[PLACE]
        self.held = 0
        self.running = self._start()

    def _start(self) -> Daemon:
        options = ["--mode", "live", "--robot", self.virtual.robot]
        options += ["--calibration", str(self.virtual.calibration)]
        for bus in self.virtual.ports:
            options += ["--port", f"{bus}={self.virtual.folder / 'ports' / bus}"]
        return Daemon(self.folder / "run", *options)

    def close(self) -> None:
        if self.running.process.poll() is None:
            self.running.process.kill()
        self.running.process.wait(10)

    def places(self) -> list[float]:
        return [servo["position"] for servo in self.virtual.servos()]

    # ----------------------------------------------------------------------- the ways to a phase

    def arm(self, client: Client) -> list[float]:
        """Armed, whatever the last daemon left behind; the places (counts) from which it was armed.

        An arming that is refused lowers the robot before the next try.
        """
        deadline = time.monotonic() + PATIENCE
        while True:
            client.call("AcquireLease", take=True)
            before = self.places()
            try:
                client.call("Arm")
                break
            except Refused:
                # Torque in some joints only: killed while arming or letting go. Or a machine too busy.
                if time.monotonic() > deadline:
                    raise
                client.call("Disarm")
                time.sleep(0.3)
        assert all(servo["torque"] for servo in self.virtual.servos())
        return before

    def path(self, place: float, seconds: float) -> dict[str, Any]:
        return {"joint_names": [JOINT], "points": [{"positions": [place], "time_from_start": seconds}]}

    def run(self, client: Client) -> None:
        """A motion there and back, acknowledged, told to its end, and true."""
        for place in (0.1, 0.0):
            self.go(client, place, 0.5)
            goal = self.middle + place * TICKS_PER_RAD
            until(lambda goal=goal: abs(self.places()[PLACE] - goal) <= NEAR, 1.0, f"the joint at {goal}")

    def go(self, client: Client, place: float, seconds: float) -> None:
        """Move; a machine that is too busy for the bus may hold the motion, and says so with a code."""
        deadline = time.monotonic() + PATIENCE
        while True:
            client.call("AcquireLease", take=True)
            try:
                *_, last = client.stream("SubmitTrajectory", trajectory=self.path(place, seconds))
            except Refused as refusal:
                last = {"phase": "refused", "findings": refusal.findings}
            if last["phase"] == "succeeded":
                return
            codes = {finding["code"] for finding in last["findings"]}
            assert codes, f"ended without a reason: {last}"
            assert codes <= BUSY, last
            assert time.monotonic() < deadline, f"held again and again: {last}"
            self.held += 1
            time.sleep(1.0)

    @contextmanager
    def phase(self, kill: Kill, client: Client) -> Iterator[None]:
        """In the phase; what is under way then is ended by the kill, and counted."""
        if kill.phase not in ("disarmed", "arming"):
            self.arm(client)
            kill.acknowledged = kill.acknowledged + 1
            kill.told = kill.told + 1
        workers = {
            "moving": lambda: self._follow(kill, client),
            "streaming": lambda: self._stream(kill, client),
            "arming": lambda: self._answered(kill, client, "Arm"),
            "settling": lambda: self._answered(kill, client, "Disarm"),
            "stopping": lambda: self._answered(kill, client, "EStop"),
        }
        if kill.phase == "arming":
            client.call("AcquireLease", take=True)
        if kill.phase in ("settling", "stopping"):  # from somewhere, so that there is a way
            self.go(client, 0.5, 0.8)
        worker = Thread(target=workers.get(kill.phase, lambda: None))
        worker.start()
        yield
        worker.join(10.0)
        assert not worker.is_alive(), f"{kill}: a client was left waiting"

    def _follow(self, kill: Kill, client: Client) -> None:
        """A motion of 3 s: acknowledged, then told to its end or cut off."""
        try:
            for answer in client.stream("SubmitTrajectory", trajectory=self.path(0.6, 3.0)):
                kill.acknowledged += answer["phase"] == "accepted"
                kill.told += answer["phase"] in ("succeeded", "aborted", "cancelled", "replaced")
        except Disconnected:
            kill.cut += 1

    def _stream(self, kill: Kill, client: Client) -> None:
        """Setpoints; each that is acknowledged is in force when the daemon dies, or was replaced."""
        began = time.monotonic()
        with suppress(Disconnected, NoDaemon):
            while time.monotonic() < began + 5.0:
                place = 0.1 * min(1.0, time.monotonic() - began)
                client.call("Setpoint", joint_names=[JOINT], positions=[place])
                kill.acknowledged = kill.acknowledged + 1
                kill.told = kill.told + 1
                time.sleep(0.015)

    def _answered(self, kill: Kill, client: Client, method: str) -> None:
        """A call that is answered, or cut off with its connection: never neither."""
        try:
            client.call(method)
            kill.acknowledged = kill.acknowledged + 1
            kill.told = kill.told + 1
        except (Disconnected, NoDaemon):
            kill.cut += 1

    # ----------------------------------------------------------------------- one kill

    def kill(self, phase: str) -> Kill:
        """Reach the phase, kill at a random moment, look at the servos, start anew, look again, run."""
        most = {"arming": 0.35, "settling": 0.8, "stopping": 0.8}.get(phase, 1.5)
        kill = Kill(phase, self.random.uniform(0.0, most))
        self.running.reach(state="connected")
        with self.running.client() as client, self.phase(kill, client):
            time.sleep(kill.delay)
            if phase in ("moving", "streaming"):
                assert self.running.process.poll() is None
            self.running.process.kill()
            self.running.process.wait(10)
        self._servos_stopped(kill)
        rest = self.places()
        began = time.monotonic()
        self.running = self._start()
        status = self.running.reach(state="connected", hw_connected=True)
        kill.back = time.monotonic() - began
        assert status["armed"] is False, kill
        assert status["lease"] is None, kill
        assert status["motion"] == "idle", kill
        until(lambda: self.running.status()["inherited"] == (kill.torque > 0), 2.0, f"{kill}: inherited")
        time.sleep(0.5)
        kill.moved = max(abs(now - then) for now, then in zip(self.places(), rest, strict=True))
        assert kill.moved <= COUNTS, kill
        with self.running.client() as client:
            before = self.arm(client)
            assert not any(servo["tripped"] for servo in self.virtual.servos()), kill
            shift = max(abs(now - then) for now, then in zip(self.places(), before, strict=True))
            assert shift <= ARMED, (kill, shift)
            self.run(client)
            client.call("Disarm")
        assert not any(servo["torque"] for servo in self.virtual.servos()), kill
        return kill

    def _servos_stopped(self, kill: Kill) -> None:
        """Whoever has torque had a watchdog, and it tripped in time; all come to rest."""
        time.sleep(0.2)  # more than any watchdog
        servos = self.virtual.servos()
        kill.torque = sum(servo["torque"] for servo in servos)
        unwatched = [servo["id"] for servo in servos if servo["torque"] and not servo["watchdog"]]
        assert not unwatched, f"{kill}: torque without a watchdog: {unwatched}"
        watched = [servo for servo in servos if servo["torque"]]
        assert all(servo["tripped"] for servo in watched), kill
        kill.trips = [servo["trip_delay"] for servo in watched]
        assert all(delay <= TRIP for delay in kill.trips), kill
        until(
            lambda: all(abs(servo["velocity"]) < 1 for servo in self.virtual.servos()), 5.0, f"{kill}: rest"
        )

    # ----------------------------------------------------------------------- the front alone

    def kill_front(self) -> float:
        """SIGKILL of the front in a motion: it holds, torque stays. How long until a new one answers, s."""
        self.running.reach(state="connected")
        with self.running.client() as client:
            self.arm(client)
            cut = False
            killed = 0.0
            try:
                for answer in client.stream("SubmitTrajectory", trajectory=self.path(0.8, 4.0)):
                    if not killed and answer["progress"] > 0.1:
                        time.sleep(self.random.uniform(0.0, 0.3))
                        os.kill(self.running.front(), signal.SIGKILL)
                        killed = time.monotonic()
            except Disconnected:
                cut = True
            assert cut, "a follower of the motion was not told that its connection ended"
        status = self.running.reach(seconds=10.0, state="armed", motion="holding")
        back = time.monotonic() - killed
        assert status["lease"] is None
        still = self.places()
        time.sleep(0.3)
        assert max(abs(now - then) for now, then in zip(self.places(), still, strict=True)) <= COUNTS
        assert all(servo["torque"] and not servo["tripped"] for servo in self.virtual.servos())
        with self.running.client() as client:
            client.call("AcquireLease")
            self.run(client)
            client.call("Disarm")
        return back


def killing(count: int, seed: int, phases: tuple[str, ...] = PHASES) -> tuple[list[Kill], list[float]]:
    """`count` kills of the loop, each fifth time the front before it. Raises AssertionError."""
    kills = []
    fronts = []
    with robot() as (virtual, folder):
        killer = Kills(virtual, folder, seed)
        try:
            for number in range(count):
                if number % 5 == 2:
                    fronts.append(killer.kill_front())
                kill = killer.kill(phases[number % len(phases)])
                kills.append(kill)
                print(f"{number + 1:4d} {_line(kill)}", flush=True)
            print(f"motions that a busy machine held, told with a code: {killer.held}")
        except (AssertionError, ClientError):
            print(
                f"seed {seed}, kill {len(kills) + 1}; the daemon's log:",
                killer.running.log.read_text()[-3000:],
            )
            raise
        finally:
            killer.close()
    return kills, fronts


def _line(kill: Kill) -> str:
    trip = f"{max(kill.trips) * 1e3:.1f} ms" if kill.trips else "-"
    acknowledged = f"{kill.acknowledged} acknowledged, {kill.told} told, {kill.cut} cut off"
    return (
        f"{kill.phase:10} +{kill.delay:.3f} s: trip {trip}, torque {kill.torque}, moved {kill.moved:g}, "
        f"back {kill.back:.2f} s, {acknowledged}"
    )


def main() -> int:
    """Kill, and report."""
    parser = argparse.ArgumentParser(prog="kills", description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=100)
    parser.add_argument("--seed", type=int, default=None, help="of an earlier run, to have it again")
    options = parser.parse_args()
    seed = options.seed if options.seed is not None else random.randrange(1 << 32)
    print(f"seed {seed}", flush=True)
    kills, fronts = killing(options.count, seed)
    trips = [delay for kill in kills for delay in kill.trips]
    lost = sum(kill.acknowledged - kill.told - kill.cut for kill in kills if kill.phase == "moving")
    print(f"{len(kills)} kills: {dict(Counter(kill.phase for kill in kills))}")
    if trips:
        print(f"{len(trips)} watchdogs tripped {min(trips) * 1e3:.1f} to {max(trips) * 1e3:.1f} ms after")
    print(f"moved by the restart: at most {max(kill.moved for kill in kills):g} counts")
    print(f"back after {max(kill.back for kill in kills):.2f} s at most")
    print(f"acknowledged {sum(kill.acknowledged for kill in kills)}, lost {lost}")
    if fronts:
        print(f"{len(fronts)} kills of the front: a new one answered after {max(fronts):.2f} s at most")
    return 0


if __name__ == "__main__":
    sys.exit(main())
