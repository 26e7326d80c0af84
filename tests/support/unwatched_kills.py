"""SIGKILL of the real daemon while a robot without watchdogs moves: `make lead-kills N=30`.

Real processes over a real pseudo-terminal. After each kill no joint moves further than its goal may lead it.
A new daemon inherits the torque and moves nothing; the fail-safe lowers the robot at the end. Some kills come
while a joint is blocked: it is released after the kill and goes on to its last goal. Before some the adapter
is unplugged and plugged in again. The arm hangs from a ceiling, so that limp or lowered it rests off its
stops.
"""

import argparse
import random
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

from tests.support.built_in_copy import change, copy_built_in
from tests.support.processes import PATIENCE, Daemon, Virtual, arm, robot, until
from twind.client import CallError, Client, ClientError, Disconnected, NoDaemon, Refused

# robot -> the joint that moves, its id
JOINTS = {"arm": ("wrist_roll", 5), "biped14": ("head_yaw", 32), "darwin": ("head_pan", 19)}
LIMIT = 0.15  # rad, `lead_limit_rad`
BRAKES = 0.05  # rad that a goal of 1.2 rad/s goes on while it brakes with 15 rad/s²
LATER = 0.02  # rad that the arm may move between the kill and the first look at it
TICKS_PER_RAD = 4096 / 6.283185307179586
LED = 0.05  # rad by which a goal leads a blocked joint at least
UNDERWAY = 5.0  # counts that a joint moves in 0.05 s at least
ARMINGS = 3  # calls of Arm at most where a busy machine is not the reason given
LOWERINGS = 3  # starts of the fail-safe at most
TRIES = 60
COUNTS = 2  # that a joint may move where nothing may move
PHASES = ("moving", "streaming", "blocked", "unplugged")


def hanging_arm(folder: Path) -> str:
    """Write the built-in arm, hung from a ceiling; the path of its robot file."""
    made = copy_built_in("so101", folder)
    change(folder / "so101.xml", '<body name="base">', '<body name="base" pos="0 0 1">')
    shoulder = '<body name="shoulder" pos="0 0 '
    change(folder / "so101.xml", f'{shoulder}0.0624">', f'{shoulder}-0.05" quat="0 1 0 0">')
    change(made, "[-1.6, 1.66]", "[-1.66, 1.66]")
    head, _, _ = made.read_text().partition("  rest: {")
    made.write_text(f"{head}  rest: {{elbow_flex: -1.4}}\n")
    return str(made)


def robot_file(name: str, folder: Path) -> str:
    """The path of the robot file of a name in `JOINTS`; what must be written goes into `folder`."""
    return hanging_arm(folder) if name == "arm" else f"docs/examples/{name}/{name}.yaml"


@dataclass
class UnwatchedKill:
    """One kill, and what was seen of it."""

    phase: str
    delay: float  # s after the phase was reached
    led: float = 0.0  # rad, largest distance of a joint from its last goal when the daemon died
    went: float = 0.0  # rad, largest way of a joint after that
    moved: float = 0.0  # counts, most of any joint, through the restart
    back: float = 0.0  # s until the new daemon was connected
    plugged: float = 0.0  # s until a replugged robot was connected
    state: str = ""  # of the daemon then


class UnwatchedKills:
    """A virtual arm and one daemon after the other."""

    def __init__(self, virtual: Virtual, folder: Path, seed: int, joint: str, id: int) -> None:
        """`joint`, `id`: what moves."""
        self.goes_on = True  # the client moves the joint again and again
        self.joint = joint
        self.id = id
        self.virtual = virtual
        self.folder = folder
        self.random = random.Random(seed)
        self.options = ["--mode", "live", "--robot", virtual.robot, "--calibration", str(virtual.calibration)]
        self.options += ["--port", f"main={virtual.folder / 'ports' / 'main'}"]
        self.running = Daemon(folder / "run", *self.options)

    def wait_identified(self) -> None:
        """Wait for the daemon; start another where a busy machine lost a reply of the identification."""
        for _ in range(TRIES):
            status = self.running.reach(state="connected")
            if not any("was not read" in each["message"] for each in status["faults"]):
                return
            self.running.kill()
            self.running = Daemon(self.folder / "run", *self.options)
        raise AssertionError("identification failed again and again")

    def close(self) -> None:
        if self.running.process.poll() is None:
            self.running.process.kill()
        self.running.process.wait(10)

    def places(self) -> list[float]:
        return [servo["position"] for servo in self.virtual.servos()]

    # ----------------------------------------------------------------------- phases

    def _path(self, place: float, seconds: float) -> dict[str, Any]:
        return {"joint_names": [self.joint], "points": [{"positions": [place], "time_from_start": seconds}]}

    def _swing(self, client: Client) -> None:
        """Move there and back."""
        for place in (1.0, -1.0):
            client.call("AcquireLease", take=True)
            for _ in client.stream("SubmitTrajectory", trajectory=self._path(place, 2.5)):
                pass

    def _stream(self, client: Client) -> None:
        """Stream setpoints there and back at 1 rad/s, from where the joint is."""
        client.call("AcquireLease", take=True)
        joints = {each["name"]: each for each in client.call("GetStatus", joints=True)["joints"]}
        began = time.monotonic() - 1.0 + max(-1.0, min(1.0, joints[self.joint]["position"] or 0.0))
        while (passed := time.monotonic() - began) < 5.0:
            client.call("Setpoint", joint_names=[self.joint], positions=[abs(passed % 4.0 - 2.0) - 1.0])
            time.sleep(0.015)

    def _until_gone(self, move: Callable[[Client], None], client: Client) -> None:
        """Move until the daemon or the adapter is gone; a busy machine that refuses is asked again."""
        with suppress(Disconnected, NoDaemon):
            while self.goes_on:
                try:
                    move(client)
                except CallError:
                    if self.goes_on:
                        self._recover(client)

    def _arm(self, client: Client) -> None:
        """Arm; a goal that was lost on a busy machine is asked for again too."""
        for _ in range(ARMINGS - 1):
            with suppress(Refused):
                arm(client, take=True)
                return
        arm(client, take=True)

    def _recover(self, client: Client) -> None:
        """Arm again where a busy machine has ended the motion with a fault, or has lowered the robot."""
        time.sleep(0.3)
        if client.call("GetStatus")["status"]["state"] != "armed":
            for method in ("AcquireLease", "Disarm", "Reset", "Arm"):
                with suppress(CallError):
                    client.call(method)

    def kill(self, phase: str) -> UnwatchedKill:
        """Reach the phase, kill at a random moment, look at the arm, start anew, look again."""
        kill = UnwatchedKill(phase, self.random.uniform(0.0, 1.5))
        with self.running.client() as client:
            self._arm(client)
            self.goes_on = True
            move = self._stream if phase == "streaming" else self._swing
            worker = Thread(target=self._until_gone, args=(move, client))
            worker.start()
            time.sleep(0.3)
            if phase == "blocked":
                self.virtual.order(fault="lock", id=self.id)
            time.sleep(kill.delay)
            until(lambda: self._is_underway(phase), PATIENCE, f"{kill}: a joint that moves")
            if phase == "unplugged":
                self._replug(kill)
            assert self.running.process.poll() is None
            self.running.process.kill()
            self.running.process.wait(10)
            servos = self.virtual.servos()
            worker.join(10.0)
            assert not worker.is_alive(), f"{kill}: a client was left waiting"
        self.virtual.order(fault="free", id=self.id)
        if all(servo["torque"] for servo in servos):
            self._came_to_rest(kill, servos)
        else:
            kill.phase = "released"  # a busy machine: bus errors had lowered the arm
        self._restarted(kill)
        return kill

    def _is_underway(self, phase: str) -> bool:
        """Return whether the joint moves now, or its goal leads the blocked joint."""
        before = self._servo()
        time.sleep(0.05)
        servo = self._servo()
        led = abs(servo["goal"] - servo["position"]) / TICKS_PER_RAD
        moved = abs(servo["position"] - before["position"])
        return bool(servo["torque"]) and (led > LED if phase == "blocked" else moved > UNDERWAY)

    def _servo(self) -> dict[str, Any]:
        return next(each for each in self.virtual.servos() if each["id"] == self.id)

    def _replug(self, kill: UnwatchedKill) -> None:
        """Unplug the adapter for a while; nothing moves further than its goal leads, nor at the replug."""
        self.goes_on = False  # it would disarm
        self.virtual.order(fault="unplug", bus="main")
        self._came_to_rest(kill, self.virtual.servos())
        rest = self.places()
        self.virtual.order(fault="replug", bus="main")
        began = time.monotonic()
        kill.state = self.running.reach(hw_connected=True)["state"]
        kill.plugged = time.monotonic() - began
        kill.moved = max(abs(now - then) for now, then in zip(self.places(), rest, strict=True))
        assert kill.moved <= COUNTS, kill

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
        moved = max(abs(now - then) for now, then in zip(self.places(), rest, strict=True))
        kill.moved = max(kill.moved, moved)
        assert kill.moved <= COUNTS, kill
        self.wait_identified()

    def lower(self) -> int:
        """Kill the daemon and let the fail-safe take the robot over; its exit code.

        A busy machine may lose the last replies. Then it is started again.
        """
        self.running.process.kill()
        self.running.process.wait(10)
        command = [sys.executable, "-m", "twind.cli", "--failsafe", *self.options]
        for _ in range(LOWERINGS):
            if (code := subprocess.run(command, check=False, timeout=60).returncode) == 0:
                break
            print(f"fail-safe started again after exit code {code}")
        assert not any(servo["torque"] for servo in self.virtual.servos())
        return code


def unwatched_kills(count: int, seed: int, name: str = "arm") -> list[UnwatchedKill]:
    """Kill so many times, then run the fail-safe. Raises AssertionError."""
    kills: list[UnwatchedKill] = []
    with (
        TemporaryDirectory(prefix="twind-arm-") as place,
        robot(robot_file(name, Path(place))) as (virtual, folder),
    ):
        killer = UnwatchedKills(virtual, folder, seed, *JOINTS[name])
        try:
            killer.wait_identified()
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
    parser.add_argument("--robot", choices=JOINTS, default="arm")
    options = parser.parse_args()
    seed = options.seed if options.seed is not None else random.randrange(1 << 32)
    print(f"seed {seed}", flush=True)
    kills = unwatched_kills(options.count, seed, options.robot)
    for phase in (*PHASES, "released"):
        own = [kill for kill in kills if kill.phase == phase]
        led = max((kill.led for kill in own), default=0.0)
        went = max((kill.went for kill in own), default=0.0)
        print(f"{len(own)} kills {phase}: goal at most {led:.3f} rad ahead, then moved {went:.3f} rad")
    plugged = [kill for kill in kills if kill.plugged]
    states = ", ".join(sorted({kill.state for kill in plugged}))
    print(
        f"replugged: back after {max((kill.plugged for kill in plugged), default=0.0):.2f} s, then {states}"
    )
    print(f"moved by the restart: at most {max(kill.moved for kill in kills):g} counts")
    print(f"back after {max(kill.back for kill in kills):.2f} s at most; the fail-safe switched torque off")
    return 0


if __name__ == "__main__":
    sys.exit(main())
