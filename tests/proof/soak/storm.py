"""Minutes of real processes: daemon, front and virtual servos with the monitor between, in a storm of faults.

A client plays, streams and runs a policy, others come and go, faults are ordered; recorder, viewer, monitor,
metrics and a reading program run beside. Each second every process is weighed.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections import deque
from contextlib import suppress
from typing import Any

import numpy as np

from tests.proof.faults.fault import Fault
from tests.proof.faults.ground import TRIES, Ground
from tests.proof.soak.companions import ROOT, Companions
from tests.proof.soak.growth import Growth
from tests.support.fault_cases import CASES, healing, order
from tests.support.processes import favour
from twind.client import CallError, Client, ClientError

IDLE = {"free", "replug", "clear", "seed", "record"}
ROBOT = "h24-standing"
POLICY = ROOT / "tests" / "data" / "policies" / "squat" / "squat.onnx"  # for this robot
# Share of packets: kernel workers of normal priority carry the bytes of a tty, and on a busy machine requests
# of some ticks come in one piece (1 of 199,246 packets at a load of 6). In virtual time none may be so (W9).
EARLY = "1e-4"
SLOW = 180.0  # s that a policy may take besides: this machine is busy, and its imports are many
CODES = (0, 1, 3)  # as asked; refused, or ended otherwise; no daemon that answers
SPAN = {"head_yaw": 0.6, "l_elbow": -0.8, "r_elbow": -0.8, "l_shoulder_roll": 0.8, "l_knee": 0.5}


class Storm:
    """One robot, until `until`."""

    def __init__(self, seconds: float, seed: int) -> None:
        self.ground = Ground(Fault(0, "storm", (), 0.0, ""), seed)
        self.random = self.ground.random
        self.seconds = seconds
        self.wrong = self.ground.wrong
        self.grown: dict[str, Growth] = {}
        self.count: dict[str, int] = {}
        self.latest: deque[str] = deque(maxlen=12)  # acts, with their time
        self.joints: list[str] = []
        self._hand = False  # one has moved a joint since the robot was armed last
        self._second = 0.0
        self.companions: Companions | None = None

    def live(self) -> dict[str, Any]:
        ground = self.ground
        ground.robot(name=ROBOT)
        ground.relayed("--early", EARLY)
        ground.daemon()
        self.companions = Companions(ground.running.sockets, ground.folder)
        self.begun = time.monotonic()
        self.until = self.begun + self.seconds
        client = ground.client()
        self.joints = [each["name"] for each in client.call("GetStatus", joints=True)["joints"]]
        client.call("AcquireLease")
        acts = (self.play, self.stream, self.visit, self.wait, self.fault, self.policy)
        while time.monotonic() < self.until and not self.wrong:
            act = acts[int(self.random.choice(len(acts), p=[0.29, 0.2, 0.15, 0.1, 0.22, 0.04]))]
            try:
                client = self.ready(client)
                act(client)
            except ClientError as error:
                if not isinstance(error, CallError):
                    client.close()
                    client = ground.client()
                self._note("refused")
            self._note(act.__name__)
            self.weigh()
        if self.wrong:
            log = ground.running.log.read_text(errors="replace")[-4000:]
            self.wrong += [f"acts before: {', '.join(self.latest)}", f"end of the daemon's log:\n{log}"]
        self.wrong += [each for grown in self.grown.values() for each in grown.wrong()]
        self.wrong += self.companions.end()
        if ground.running.end() != 0:
            self.wrong.append("the daemon did not end well")
        lived = time.monotonic() - self.begun
        ground.finish()
        figures = {name: grown.figures() for name, grown in self.grown.items() if len(grown.time) > 3}
        assert ground.relay is not None
        return {
            "seconds": round(lived),
            "done": self.count,
            "processes": figures,
            "bus": ground.relay.counts(),
            "beside": self.companions.figures(),
        }

    def _note(self, what: str) -> None:
        self.count[what] = self.count.get(what, 0) + 1
        self.latest.append(f"{time.monotonic() - self.begun:.1f} s {what}")

    # ------------------------------------------------------------------------------------ weighing

    def pause(self, seconds: float) -> None:
        """Time passes; each second is weighed."""
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end and not self.wrong:
            self.weigh()
            time.sleep(min(0.1, end - now))

    def weigh(self) -> None:
        """Processes that live, no violation, a second since the last time."""
        ground = self.ground
        now = time.monotonic()
        if now - self._second < 1.0 or self.wrong:
            return
        self._second = now
        assert ground.relay is not None
        if ground.relay.caught:
            said = [line[:150] for line in ground.relay.printed().splitlines()]
            self.wrong += [f"bus: {line}" for line in said[:3] + said[-12:]]
            return
        if ground.running.process.poll() is not None:
            self.wrong.append(f"the daemon ended: {ground.running.log.read_text()[-400:]}")
            return
        pids = {"loop": ground.running.process.pid, "virtual": ground.virtual.process.pid}
        with suppress(AssertionError, OSError):
            front = ground.running.front()
            pids[f"front {front}"] = front
        assert self.companions is not None
        self.wrong += self.companions.look()
        pids |= dict(self.companions.pids())
        for name, pid in pids.items():
            with suppress(OSError):
                self.grown.setdefault(name, Growth(name)).look(now, pid)

    # ------------------------------------------------------------------------------------ acts

    def ready(self, client: Client) -> Client:
        """Armed and without faults, by commands; a new connection where the front hung up."""
        status = client.call("GetStatus")["status"]
        if status["state"] == "armed" and not status["faults"]:
            client.call("AcquireLease", take=True)
            return client
        for again in range(TRIES):
            self.ground.machine.forget()
            try:
                self.ground.back(client)
                self._hand = False
                break
            except AssertionError as error:
                if "by hand" in str(error) and self._hand and again < TRIES - 1:
                    self._put_back()
                    continue
                if again == TRIES - 1 or not self.ground.machine.waits:
                    self.wrong.append(f"no way back: {error}"[:400])
                    break
                self._note("way back while the machine kept processes waiting")
        return client

    def _put_back(self) -> None:
        """Joints that a hand took out of their travel without torque are put back by one."""
        self.ground.obey({"fault": "hand", "pose": dict.fromkeys(self.joints, 0.0), "speed": 3.0})
        self.pause(2.0)
        self.ground.obey({"fault": "hand", "off": True})
        self._note("put back by hand")

    def play(self, client: Client) -> None:
        """A random motion, followed to its end or left."""
        names = list(SPAN)
        knots = int(self.random.integers(1, 4))
        points = [
            {"positions": [float(self.random.random() * SPAN[name]) for name in names]}
            | {"velocities": [0.0] * len(names), "time_from_start": 1.0 * (k + 1)}
            for k in range(knots)
        ]
        most = float(self.random.uniform(0.2, 2.0))
        path = {"joint_names": names, "points": points}
        answers = client.stream("SubmitTrajectory", trajectory=path)
        for said in answers:
            self.weigh()
            if said["phase"] == "running" and said["progress"] > most:
                answers.close()
                client.close()
                break

    def stream(self, client: Client) -> None:
        """Setpoints for a second or two, then silence."""
        for number in range(int(self.random.integers(50, 200))):
            goal = 0.1 * float(np.sin(0.02 * number))
            client.call("Setpoint", joint_names=["head_yaw"], positions=[goal])
            time.sleep(0.01)
        self.weigh()

    def visit(self, client: Client) -> None:
        """Others come, ask, listen, and go, some without a word."""
        for _ in range(int(self.random.integers(1, 8))):
            with suppress(ClientError), self.ground.running.client() as other:
                other.call("GetStatus", joints=True)
                if self.random.random() < 0.5:
                    listening = other.stream("Monitor", topics=["state"], rate=100.0)
                    for _ in range(int(self.random.integers(1, 30))):
                        next(listening)
        self.weigh()

    def wait(self, client: Client) -> None:
        self.pause(float(self.random.uniform(0.1, 2.0)))

    def policy(self, client: Client) -> None:
        """A policy drives for some seconds; sometimes a fault comes into it, or a signal."""
        client.call("ReleaseLease")
        seconds = float(self.random.uniform(3.0, 10.0))
        command = ["-m", "twind.ctl.ctl_main", "--socket", str(self.ground.running.sockets), "policy", "run"]
        command += [str(POLICY), "--seconds", f"{seconds:.1f}"]
        log = self.ground.folder / "policy.log"
        with log.open("wb") as written:
            process = subprocess.Popen(
                [sys.executable, *command], stdin=subprocess.DEVNULL, stdout=written, stderr=written, cwd=ROOT
            )
        favour(process)  # as its own advice is on a busy machine
        try:
            if self.random.random() < 0.3:
                self.pause(float(self.random.uniform(2.0, 12.0)))
                if self.random.random() < 0.5:
                    process.send_signal(signal.SIGTERM)
                else:
                    self.fault(client)
            end = time.monotonic() + seconds + SLOW
            while process.poll() is None and time.monotonic() < end and not self.wrong:
                self.pause(0.2)
            if self.wrong:
                return
            code = process.poll()
            said = log.read_text(errors="replace")
            if code not in CODES or "Traceback" in said:
                self.wrong.append(f"policy run ended with {code}: {said[-600:]}")
            self._note(f"policy {code}")
        finally:
            process.kill()
            process.wait(10)

    def fault(self, client: Client) -> None:
        """One of the table, healed after a while."""
        name = str(self.random.choice(sorted(CASES.keys() - IDLE)))
        case = CASES[name][int(self.random.integers(len(CASES[name])))]
        given = order(name, case, self.random)
        self._note(f"fault {name}")
        self._hand |= name == "hand"
        self.ground.obey(given)
        self.pause(float(self.random.uniform(*case.lasts)))
        for each in healing(case, given):
            self.ground.obey(each)
        self.pause(float(self.random.uniform(0.1, 1.0)))


def storm(seconds: float, seed: int) -> dict[str, Any]:
    """So long; ends by itself. `wrong`: what must not be."""
    made = Storm(seconds, seed)
    try:
        return made.live() | {"wrong": made.wrong}
    except Exception as error:
        said = "" if made.ground.relay is None else made.ground.relay.printed()[:500]
        return {"wrong": [*made.wrong, f"the run itself failed: {error!r}"[:600], said], "done": made.count}
    finally:
        if made.companions is not None:
            made.companions.close()
        with suppress(OSError):  # a relay that ended by itself does not listen
            made.ground.close()
