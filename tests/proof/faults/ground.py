"""Real processes over pseudo-terminals, one injection: twind-virtual, the daemon, a watcher of its events.

Bounds are those of the rows. An injection in which something was wrong while the machine kept one of the
processes from running is made again, and counts only once it is not disturbed.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.proof.busmon.started import Relayed, relayed
from tests.proof.faults.fault import Fault, Outcome
from tests.proof.faults.machine import Machine
from tests.proof.faults.threads import Keeper, Watcher
from tests.support.fault_cases import Order
from tests.support.processes import Daemon, Virtual
from twind.client import CallError, Client, ClientError
from twind.config.driver_family import family
from twind.config.port_names import virtual_port
from twind.config.robot_file import load_robot

TRIES = 6  # injections until one is not disturbed
ORDER = 0.01  # s from the harness to the servos' process, which looks every 2 ms, and back in an event
DISTURBED = {"LOOP_LATE", "BUS_ERRORS", "STATE_STALE", "RX_SHAPE"}  # what it makes the daemon say
AGAIN = 10.0  # s before a mere warning is told again
SWING = {
    "head_yaw": 0.6,
    "head_pitch": -0.4,
    "l_shoulder_pitch": -0.7,
    "r_shoulder_pitch": -0.7,
    "l_elbow": -0.7,
}
STILL = 4.0  # ticks that a shaft may creep


class Ground:
    """A robot and a daemon of its own. `random` decides joint, phase and strength, by the seed."""

    def __init__(self, fault: Fault, seed: int) -> None:
        self.fault = fault
        self.outcome = Outcome(fault.number, seed)
        self.wrong = self.outcome.wrong
        self.random = np.random.default_rng([fault.number, seed, 1])
        self.stack = ExitStack()
        self.folder = Path(self.stack.enter_context(tempfile.TemporaryDirectory(prefix="twind-faults-")))
        self.relay: Relayed | None = None
        self.relay_bus = "main"  # that the relay is on
        self.swing = SWING  # joint -> rad, what moves
        self.begun = 0.0
        self._lost = 0.0  # s, of the servos' clock before the motion
        self.machine = Machine()
        self.stack.callback(self.machine.end)

    # ------------------------------------------------------------------------------------ making

    def robot(self, *options: str, name: str = "h24") -> Virtual:
        """Virtual servos without load, which cost the machine little."""
        self.virtual = Virtual(self.folder, name, "--muscles", "first-order", *options)
        self.stack.callback(self.virtual.close)
        self.machine.watch("virtual", self.virtual.process.pid, first=True)
        return self.virtual

    def relayed(self, *options: str) -> Relayed:
        """The monitor between daemon and servos from now on."""
        file = load_robot(self.virtual.robot).path
        servos = self.folder / "ports" / self.relay_bus
        made = relayed(
            self.folder,
            servos,
            file,
            self.virtual.calibration,
            bus=self.relay_bus,
            observe=self.folder / "run" / "observe.sock",
            options=options,
        )
        self.relay = self.stack.enter_context(made)
        self.machine.watch("relay", self.relay.process.pid, first=True)
        return self.relay

    def daemon(self, *, wait: bool = True, command: list[str] | None = None, **how: Any) -> Daemon:
        """A live daemon on that robot, identified."""
        options = ["--mode", "live", "--robot", self.virtual.robot]
        options += ["--calibration", str(self.virtual.calibration)]
        for bus in self.virtual.ports:
            between = self.relay is not None and bus == self.relay_bus
            port = self.relay.link if self.relay is not None and between else self.folder / "ports" / bus
            kind = load_robot(self.virtual.robot).bus(bus).kind
            options += ["--port", f"{bus}={virtual_port(family(kind).medium, str(port))}"]
        self.running = Daemon(self.folder / "run", *options, **how)
        self.stack.callback(self.end_daemon, self.running)
        self.machine.watch("daemon", self.running.process.pid)
        if self.relay is not None:
            self.relay.tell(pid=self.running.process.pid)
        if wait:
            self.running.reach(state="connected")
            self.watch()
        return self.running

    def watch(self) -> None:
        """Listen to what it tells."""
        self.watcher = Watcher(self.running)

    @staticmethod
    def end_daemon(running: Daemon) -> None:
        if running.process.poll() is None:
            running.process.kill()
        running.process.wait(10)

    def client(self) -> Client:
        found = self.running.client()
        self.stack.callback(found.close)
        return found

    def armed(self, *options: str, watched: bool = False, name: str = "h24") -> Client:
        """Robot, daemon, and a client that has armed it."""
        self.robot(*options, name=name)
        if watched:
            self.relayed()
        self.daemon()
        client = self.client()
        self.arm(client)
        return client

    def moving(self, *options: str, watched: bool = False, name: str = "h24") -> Client:
        """The same, on its way, at a random moment."""
        client = self.armed(*options, watched=watched, name=name)
        self.machine.forget()
        self._lost = self.lost()
        self.move(client)
        time.sleep(float(self.random.uniform(0.2, 1.0)))
        for _ in range(3):  # a machine that stood still has stopped it before anything was injected
            if self.running.status()["motion"] == "active":
                break
            self.move(client)
            time.sleep(0.3)
        return client

    def arm(self, client: Client, seconds: float = 12.0) -> None:
        """Tried until it is done: first readings, restarted servos and busy machines take their time."""
        end = time.monotonic() + seconds
        said = ""
        while time.monotonic() < end:
            try:
                client.call("AcquireLease", take=True)
                client.call("Arm")
                return
            except CallError as error:
                said = str(error)
                time.sleep(0.1)
        raise AssertionError(f"never armed: {said[:300]}")

    def move(self, client: Client) -> None:
        """Some joints away and back for a minute."""
        names = list(self.swing)
        points = [
            {"positions": [self.swing[name] * (k % 2) for name in names], "time_from_start": 1.2 * k}
            | {"velocities": [0.0] * len(names)}
            for k in range(1, 40)
        ]
        for left in (2, 1, 0):  # a lease may lapse between two calls on a machine that stands still
            try:
                client.call("AcquireLease", take=True)
                client.call("SubmitTrajectory", trajectory={"joint_names": names, "points": points})
                break
            except CallError:
                if not left:
                    raise
        self.keeper = Keeper(client)

    # ------------------------------------------------------------------------------------ faults

    def inject(self, *orders: Order) -> None:
        self.begun = time.monotonic()
        self.obey(*orders)

    def obey(self, *orders: Order) -> None:
        for each in orders:
            self.virtual.order(**each)

    def swinging(self, far: float = 0.0) -> int:
        """The id of a joint that moves, by `far` rad at least."""
        joints = {joint.name: joint.id for joint in load_robot(self.virtual.robot).joints}
        return int(
            joints[str(self.random.choice([name for name, to in self.swing.items() if abs(to) >= far]))]
        )

    def claim(self, right: bool, what: str) -> None:
        if not right:
            self.wrong.append(what)

    def first_report(self, codes: Iterable[str] | None = None) -> float | None:
        """Time of the first of these reports since the injection."""
        wanted = set(codes if codes is not None else self.fault.codes)
        times = [
            event["time"]
            for event in list(self.watcher.events)
            if event["time"] >= self.begun - 0.005
            and (event["code"] in wanted or wanted & {each["code"] for each in event.get("findings") or []})
        ]
        return min(times, default=None)

    def detected(self, bound: float | None = None, codes: Iterable[str] | None = None) -> bool:
        """Told within the bound."""
        bound = (self.fault.bound if bound is None else bound) + ORDER
        if not self.until(lambda: self.first_report(codes) is not None, bound + 1.0):
            if self.reported_before(codes if codes is not None else self.fault.codes):
                self.machine.note("told already before: a warning is not told again within 10 s")
            said = sorted({event["code"] for event in self.watcher.events if event["time"] >= self.begun})
            self.wrong.append(f"not told within {bound:.2f} s; told was {said}")
            return False
        told = self.first_report(codes)
        assert told is not None
        self.outcome.bound = bound
        self.outcome.delay = max(0.0, told - self.begun)
        self.claim(self.outcome.delay <= bound, f"told after {self.outcome.delay:.3f} s, bound {bound:.3f} s")
        return True

    def bad(self) -> int:
        """Exchanges so far in which somebody was not understood, as the daemon counts them."""
        return sum(int(bus["errors"]) for bus in self.running.status()["buses"])

    def counted(self, before: int) -> None:
        """Claim that dropped answers are counted; two bad of a hundred are reported, one need not be."""
        counted = self.until(lambda: self.bad() > before, 1.0)
        self.claim(counted, "neither told nor counted")

    def reported_before(self, codes: Iterable[str]) -> bool:
        """One of these was told in the last seconds before the injection: a machine that stood still."""
        wanted = set(codes) & DISTURBED
        events = list(self.watcher.events)
        return any(e["code"] in wanted and -AGAIN <= e["time"] - self.begun < 0.0 for e in events)

    @staticmethod
    def until(what: Callable[[], bool], seconds: float) -> bool:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if what():
                return True
            time.sleep(0.01)
        return what()

    # ------------------------------------------------------------------------------------ servos

    def servos(self) -> list[dict[str, Any]]:
        return self.virtual.servos()

    def behind(self, id: int) -> float:
        """Ticks between the goal of a servo and its shaft."""
        return next(abs(s["goal"] - s["position"]) for s in self.servos() if s["id"] == id)

    def places(self) -> np.ndarray:
        return np.array([servo["position"] for servo in self.servos()])

    def stands(self, seconds: float = 0.4, but: Iterable[int] = ()) -> None:
        """From now on shafts stand still."""
        keep = [servo["id"] not in set(but) for servo in self.servos()]
        before = self.places()
        time.sleep(seconds)
        moved = np.abs(self.places() - before)[keep]
        self.claim(bool((moved <= STILL).all()), f"shafts go on: {moved.max():.0f} ticks in {seconds} s")

    def torque(self, on: bool, but: Iterable[int] = ()) -> None:
        """Everybody's torque is so."""
        wrong = [s["id"] for s in self.servos() if bool(s["torque"]) != on and s["id"] not in set(but)]
        self.claim(not wrong, f"torque of {wrong} is {'off' if on else 'on'}")

    def lowered(self, seconds: float = 8.0, but: Iterable[int] = ()) -> None:
        """At the rest pose without torque."""
        skip = set(but)
        off = self.until(lambda: not any(s["torque"] for s in self.servos() if s["id"] not in skip), seconds)
        self.claim(off, f"torque is still on {seconds} s later")

    def goes_on(self, seconds: float = 1.4) -> None:
        """Shafts move on, under torque: also when a stop, if there was one, is over. A stroke takes 1.2 s."""
        time.sleep(0.4)
        before = self.places()
        moved = self.until(lambda: float(np.abs(self.places() - before).max()) > 20.0, seconds + 1.2)
        self.claim(moved, "the motion ended")
        self.torque(True)

    def disturbed(self) -> bool:
        """The machine kept us from running, or the daemon says so."""
        return self.reported_before(DISTURBED) or self.first_report(DISTURBED) is not None

    def lost(self) -> float:
        """s that the servos' process did not run, by its own account."""
        return float(self.virtual.order(query="state")["lost"])

    def last_events(self) -> str:
        """Events since the motion began, for the message of a failure."""
        events = list(self.watcher.events) if hasattr(self, "watcher") else []
        return ", ".join(f"{each['time'] - self.begun:+.2f} {each['code']}" for each in events[-30:])

    def note_lost(self) -> None:
        """Note the stops that the servos' process reports of itself."""
        if hasattr(self, "virtual") and (more := self.lost() - self._lost) > 0.0:
            self.machine.note(f"the servos' clock stood still for {more * 1e3:.0f} ms")

    def recover(self) -> None:
        """Nothing by itself; then off, acknowledged, restarted, armed, moving, by commands."""
        if hasattr(self, "keeper"):
            self.keeper.end()
        before = [bool(servo["torque"]) for servo in self.servos()]
        time.sleep(0.5)
        after = [bool(servo["torque"]) for servo in self.servos()]
        self.claim(
            not any(b and not a for a, b in zip(before, after, strict=True)), "torque came on by itself"
        )
        try:
            with self.running.client() as client:
                self.back(client)
                self.move(client)
                self.goes_on()
                self.keeper.end()
        except (AssertionError, ClientError) as error:
            self.wrong.append(f"no way back: {error!r}"[:400])

    def back(self, client: Client) -> None:
        """Armed again, from whatever there is. Raises AssertionError."""
        end = time.monotonic() + 30.0
        while True:
            if self.relay is not None:
                self.relay.tell(level="cut")  # of the next e-stop that the daemon tells
            with suppress(CallError):
                client.call("EStop", level="cut")
            try:
                client.call("Reset")
                for joint in client.call("GetStatus", joints=True)["joints"]:
                    if joint["faults"]:
                        with suppress(CallError):
                            client.call("Reboot", bus=joint["bus"], id=joint["id"])
                self.arm(client, 6.0)
                return
            except (CallError, AssertionError) as error:
                if time.monotonic() > end:
                    raise AssertionError(str(error)) from None
                time.sleep(0.2)

    def finish(self) -> Outcome:
        if self.relay is not None and self.relay.end() != 0:
            said = [line for line in self.relay.printed().splitlines() if line.startswith("violation")]
            self.wrong += [f"bus: {line}" for line in said[:3]]
        return self.outcome

    def close(self) -> None:
        if hasattr(self, "keeper"):
            self.keeper.end()
        self.stack.close()


def once_real(fault: Fault, seed: int) -> Outcome:
    """One injection in real time, made again while it is wrong and the machine disturbed it."""
    for again in range(TRIES):
        found, waits = _attempt(fault, seed)
        if not found.wrong or not waits:
            break
        disturbed = [f"disturbed, try {again + 1} of {TRIES}: {'; '.join(waits[:3])}"]
        found = replace(found, wrong=found.wrong + disturbed)
    return replace(found, again=again)


def _attempt(fault: Fault, seed: int) -> tuple[Outcome, list[str]]:
    """One injection, and what disturbed it. An exception is a wrong outcome."""
    ground = Ground(fault, seed)
    try:
        assert fault.real is not None
        fault.real(ground)
        ground.note_lost()
        ground.finish()
        if ground.wrong:
            ground.wrong.append(f"told: {ground.last_events()}")
        return ground.outcome, list(ground.machine.waits)
    except Exception as error:
        ground.wrong.append(f"the run itself failed: {error!r}"[:600])
        with suppress(Exception):
            ground.note_lost()
            ground.finish()
        return ground.outcome, list(ground.machine.waits)
    finally:
        try:
            ground.close()
        except Exception as error:
            print(f"row {fault.number} seed {seed}: closing failed: {error!r}", file=sys.stderr)
