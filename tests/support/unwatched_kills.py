"""SIGKILL of the real daemon while an arm without watchdogs moves: `make lead-kills N=30`.

Real processes over a real pseudo-terminal. After each kill no joint moves further than its goal may lead it.
A new daemon inherits the torque and moves nothing; the fail-safe lowers the arm at the end. One kill in three
comes while a joint is blocked: it is released after the kill and goes on to its last goal.
"""

import argparse
import random
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any

from tests.support.processes import Daemon, Virtual, robot, until
from twind.client import Client, ClientError, Disconnected, NoDaemon, Refused

ARM = "docs/examples/so101/so101.yaml"
JOINT = "wrist_roll"
ID = 5
LIMIT = 0.15  # rad, `lead_limit_rad`
BRAKES = 0.05  # rad that a goal of 1.2 rad/s goes on while it brakes with 15 rad/s²
LATER = 0.02  # rad that the arm may move between the kill and the first look at it
TICKS_PER_RAD = 4096 / 6.283185307179586
TRIES = 60
COUNTS = 2  # that a joint may move where nothing may move
PHASES = ("moving", "streaming", "blocked")


@dataclass
class UnwatchedKill:
    """One kill, and what was seen of it."""

    phase: str
    delay: float  # s after the phase was reached
    led: float = 0.0  # rad, largest distance of a joint from its last goal when the daemon died
    went: float = 0.0  # rad, largest way of a joint after that
    moved: float = 0.0  # counts, most of any joint, through the restart
    back: float = 0.0  # s until the new daemon was connected


class UnwatchedKills:
    """A virtual arm and one daemon after the other."""

    def __init__(self, virtual: Virtual, folder: Path, seed: int) -> None:
        self.virtual = virtual
        self.folder = folder
        self.random = random.Random(seed)
        self.options = ["--mode", "live", "--robot", virtual.robot, "--calibration", str(virtual.calibration)]
        self.options += ["--port", f"main={virtual.folder / 'ports' / 'main'}"]
        self.running = Daemon(folder / "run", *self.options)
        self._identified()

    def _arm(self, client: Client) -> None:
        """Arm; a busy machine is asked again. A limp elbow lies beyond its stop by a count: it is lifted."""
        refused = ""
        for _ in range(TRIES):
            if not all(servo["torque"] for servo in self.virtual.servos()):
                self.virtual.order(fault="hand", id=3, rad=1.5)
                until(lambda: abs(self._angle(3) - 1.5) < 0.05, 5.0, "the elbow is lifted")
            try:
                client.call("AcquireLease", take=True)
                client.call("Arm")
            except Refused as refusal:
                refused = str(refusal)
                if "OUT_OF_LIMIT" in refused:  # it was lowered to its stop, and torque is on
                    with suppress(ClientError):
                        client.call("EStop", level="cut")
                        client.call("Reset")
                time.sleep(0.5)
            else:
                self.virtual.order(fault="hand", id=3, off=True)
                return
        raise AssertionError(f"arming was refused again and again: {refused}")

    def _identified(self) -> None:
        """Wait for the daemon; start another where a busy machine lost a reply of the identification."""
        for _ in range(TRIES):
            status = self.running.reach(state="connected")
            if not any("was not read" in each["message"] for each in status["faults"]):
                return
            self.running.kill()
            self.running = Daemon(self.folder / "run", *self.options)
        raise AssertionError("identification failed again and again")

    def _angle(self, id: int) -> float:
        """Angle of a joint, rad, as the daemon reports it."""
        with self.running.client() as client:
            return float(client.call("GetStatus", joints=True)["joints"][id - 1]["position"])

    def close(self) -> None:
        if self.running.process.poll() is None:
            self.running.process.kill()
        self.running.process.wait(10)

    def places(self) -> list[float]:
        return [servo["position"] for servo in self.virtual.servos()]

    # ----------------------------------------------------------------------- phases

    def _path(self, place: float, seconds: float) -> dict[str, Any]:
        return {"joint_names": [JOINT], "points": [{"positions": [place], "time_from_start": seconds}]}

    def _swing(self, client: Client) -> None:
        """Move there and back until the daemon is gone."""
        with suppress(Disconnected, NoDaemon, Refused):
            for place in (1.0, -1.0) * 5:
                client.call("AcquireLease", take=True)
                for _ in client.stream("SubmitTrajectory", trajectory=self._path(place, 2.5)):
                    pass

    def _stream(self, client: Client) -> None:
        began = time.monotonic()
        with suppress(Disconnected, NoDaemon, Refused):
            client.call("AcquireLease", take=True)
            while True:
                place = min(1.0, time.monotonic() - began)
                client.call("Setpoint", joint_names=[JOINT], positions=[place])
                time.sleep(0.015)

    def kill(self, phase: str) -> UnwatchedKill:
        """Reach the phase, kill at a random moment, look at the arm, start anew, look again."""
        kill = UnwatchedKill(phase, self.random.uniform(0.0, 1.5))
        with self.running.client() as client:
            self._arm(client)
            worker = Thread(target=self._stream if phase == "streaming" else self._swing, args=(client,))
            worker.start()
            time.sleep(0.3)
            if phase == "blocked":
                self.virtual.order(fault="lock", id=ID)
            time.sleep(kill.delay)
            assert self.running.process.poll() is None
            self.running.process.kill()
            self.running.process.wait(10)
            servos = self.virtual.servos()
            worker.join(10.0)
            assert not worker.is_alive(), f"{kill}: a client was left waiting"
        self.virtual.order(fault="free", id=ID)
        if all(servo["torque"] for servo in servos):
            self._came_to_rest(kill, servos)
        else:
            kill.phase = "released"  # a busy machine: bus errors had lowered the arm
        self._restarted(kill)
        return kill

    def _came_to_rest(self, kill: UnwatchedKill, servos: list[dict[str, Any]]) -> None:
        """Check that the arm holds its last goal, not far from where the daemon left it."""
        assert all(servo["torque"] for servo in servos), kill
        kill.led = max(abs(servo["goal"] - servo["position"]) for servo in servos) / TICKS_PER_RAD
        time.sleep(0.3)
        until(lambda: all(abs(each["velocity"]) < 1 for each in self.virtual.servos()), 5.0, f"{kill}: rest")
        after = self.places()
        ways = [abs(now - servo["position"]) for now, servo in zip(after, servos, strict=True)]
        kill.went = max(ways) / TICKS_PER_RAD
        most = LIMIT + LATER + (BRAKES if kill.phase == "blocked" else 0.0)
        assert kill.led <= most, kill
        assert kill.went <= most, kill

    def _restarted(self, kill: UnwatchedKill) -> None:
        """Start a daemon as the service manager does: it reports the torque, and moves nothing."""
        rest = self.places()
        began = time.monotonic()
        self.running = Daemon(self.folder / "run", *self.options)
        status = self.running.reach(state="connected", hw_connected=True)
        kill.back = time.monotonic() - began
        assert (status["armed"], status["motion"]) == (False, "idle"), kill
        assert status["unwatched"], status
        inherits = kill.phase != "released"
        until(lambda: self.running.status()["inherited"] is inherits, 2.0, f"{kill}: inherited")
        time.sleep(0.2)
        kill.moved = max(abs(now - then) for now, then in zip(self.places(), rest, strict=True))
        assert kill.moved <= COUNTS, kill
        self._identified()

    def lower(self) -> int:
        """Kill the daemon and let the fail-safe take the arm over; its exit code."""
        self.running.process.kill()
        self.running.process.wait(10)
        command = [sys.executable, "-m", "twind.cli", "--failsafe", *self.options]
        code = subprocess.run(command, check=False, timeout=60).returncode
        assert not any(servo["torque"] for servo in self.virtual.servos())
        return code


def unwatched_kills(count: int, seed: int) -> list[UnwatchedKill]:
    """Kill so many times, then run the fail-safe. Raises AssertionError."""
    kills: list[UnwatchedKill] = []
    with robot(ARM) as (virtual, folder):
        killer = UnwatchedKills(virtual, folder, seed)
        try:
            for number in range(count):
                kills.append(killer.kill(PHASES[number % len(PHASES)]))
                print(f"{number + 1:4d} {kills[-1]}", flush=True)
            assert killer.lower() == 0
        except (AssertionError, ClientError):
            print(f"seed {seed}, kill {len(kills) + 1}:", killer.running.log.read_text()[-3000:])
            raise
        finally:
            killer.close()
    return kills


def main() -> int:
    """Kill, and report."""
    parser = argparse.ArgumentParser(prog="unwatched-kills", description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=30)
    parser.add_argument("--seed", type=int, default=None, help="of an earlier run, to have it again")
    options = parser.parse_args()
    seed = options.seed if options.seed is not None else random.randrange(1 << 32)
    print(f"seed {seed}", flush=True)
    kills = unwatched_kills(options.count, seed)
    for phase in (*PHASES, "released"):
        own = [kill for kill in kills if kill.phase == phase]
        led = max((kill.led for kill in own), default=0.0)
        went = max((kill.went for kill in own), default=0.0)
        print(f"{len(own)} kills {phase}: goal at most {led:.3f} rad ahead, then moved {went:.3f} rad")
    print(f"moved by the restart: at most {max(kill.moved for kill in kills):g} counts")
    print(f"back after {max(kill.back for kill in kills):.2f} s at most; the fail-safe switched torque off")
    return 0


if __name__ == "__main__":
    sys.exit(main())
