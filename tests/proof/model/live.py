"""Several clients at a real daemon over its real socket, doing what chance says; the history is judged.

Nothing is in step here: calls of different clients overlap as the machine schedules them.
"""

import os
import random
import signal
import threading
import time
from contextlib import suppress
from itertools import count

from tests.proof.model.history import ENDS, History, Op
from tests.support.processes import Daemon
from twind.client import Client, ClientError, Disconnected, NoAnswer, NoDaemon, Refused
from twind.client.errors import CallError

VERBS = ("acquire", "acquire", "take", "renew", "release", "submit", "follow", "stream", "cancel")
SLACK = 0.3  # s until the loop has heard of a connection that closed, on a busy machine
JOINT = "head_yaw"


class Workload:
    """Clients, a watcher of events, and what they saw."""

    def __init__(self, daemon: Daemon, seed: int) -> None:
        self.daemon = daemon
        self.seed = seed
        self.history = History(slack=SLACK)
        self._numbers = count(1)
        self._lock = threading.Lock()
        self._motions: dict[str, Op] = {}
        self._ends: dict[str, tuple[str, tuple[str, ...]]] = {}
        self._until = self._latest = 0.0
        self._ended = threading.Event()
        self.events = 0
        self.gaps: list[str] = []
        self._watched = threading.Event()

    def run(self, seconds: float, clients: int = 3, *, kill_front: bool = False) -> None:
        """Let them all loose: for that long, and on a slow machine until enough has happened to be judged."""
        self._until = time.monotonic() + seconds
        self._latest = self._until + 5.0 * seconds
        watcher = threading.Thread(target=self._watch)
        watcher.start()
        assert self._watched.wait(10.0)
        workers = [threading.Thread(target=self._work, args=(place,)) for place in range(clients)]
        for worker in workers:
            worker.start()
        if kill_front:
            time.sleep(seconds / 2)
            with self._lock:
                self.history.deaths.append(time.monotonic())
                for op in self._motions.values():  # their ends may be told to nobody
                    op.fate = op.fate or "lost"
            os.kill(self.daemon.front(), signal.SIGKILL)
        for worker in workers:
            worker.join(6.0 * seconds + 60.0)
            assert not worker.is_alive(), "a client was left waiting"
        time.sleep(3.0)  # the ends of the last motions
        self._ended.set()
        watcher.join(20.0)
        for id, op in self._motions.items():
            op.fate, op.codes = self._ends.get(id, (op.fate, op.codes))

    def enough(self) -> bool:
        """Calls were obeyed and a lease refused, to several; somebody moved the robot."""
        with self._lock:
            ops = list(self.history.ops)
        return (
            sum(op.ok for op in ops) > 10
            and any(op.motion for op in ops)
            and any(op.result == "LeaseHeld" for op in ops)
            and len({op.client for op in ops if op.ok and op.name == "AcquireLease"}) > 1
        )

    # ----------------------------------------------------------------------- one client

    def _over(self) -> bool:
        now = time.monotonic()
        return now >= self._latest or (now >= self._until and self.enough())

    def _work(self, place: int) -> None:
        chance = random.Random(f"{self.seed} {place}")
        while not self._over():
            number = next(self._numbers)
            with suppress(Disconnected, NoDaemon), self.daemon.client() as client:
                for _ in range(chance.randrange(3, 15)):
                    if self._over():
                        break
                    self._step(client, number, chance)
                    time.sleep(chance.choice([0.0, 0.01, 0.05, 0.3, 1.05]))
                self.history.gone[number] = time.monotonic()
            self.history.gone.setdefault(number, time.monotonic())

    def _step(self, client: Client, number: int, chance: random.Random) -> None:
        what = chance.choice(VERBS)
        if what in ("acquire", "take"):
            take = what == "take" and chance.random() < 0.5
            self._call(client, Op(number, "AcquireLease", 0.0, take=take), "AcquireLease", take=take)
        elif what in ("renew", "release"):
            name = "RenewLease" if what == "renew" else "ReleaseLease"
            self._call(client, Op(number, name, 0.0), name)
        elif what == "cancel":
            client.call("Cancel")
        elif what == "stream":
            for _ in range(5):
                op = Op(number, "Setpoint", 0.0)
                self._call(client, op, "Setpoint", joint_names=[JOINT], positions=[0.0], allow_clamp=True)
                time.sleep(0.02)
        else:
            self._submit(client, Op(number, "SubmitTrajectory", 0.0, more=what == "follow"), chance)

    def _call(self, client: Client, op: Op, method: str, **parameters: object) -> dict[str, object]:
        op.begin = time.monotonic()
        with self._lock:
            self.history.ops.append(op)
        try:
            answer = client.call(method, **parameters)
            op.result = "ok"
            return answer
        except Refused as refusal:
            codes = [finding["code"] for finding in refusal.findings]
            op.result = "LEASE_MISSING" if "LEASE_MISSING" in codes else codes[0]
        except CallError as error:
            op.result = error.name.rpartition(".")[2]
        except (Disconnected, NoDaemon, NoAnswer):
            op.result = "lost"
            raise
        finally:
            op.end = time.monotonic()
        return {}

    def _submit(self, client: Client, op: Op, chance: random.Random) -> None:
        point = {"positions": [chance.uniform(-0.2, 0.2)], "time_from_start": chance.uniform(0.5, 1.2)}
        path = {"joint_names": [JOINT], "points": [point], "append_stop": True}
        if not op.more:
            answer = self._call(client, op, "SubmitTrajectory", trajectory=path)
            if op.ok:
                self._begun(op, str(answer["id"]))
            return
        op.begin = time.monotonic()
        with self._lock:
            self.history.ops.append(op)
        try:
            for answer in client.stream("SubmitTrajectory", trajectory=path):
                if not op.result:
                    op.end = time.monotonic()
                    op.result = "ok"
                    self._begun(op, str(answer["id"]))
                if answer["phase"] in ENDS:
                    op.fate = answer["phase"]
                    op.codes = tuple(finding["code"] for finding in answer.get("findings") or ())
        except Refused as refusal:
            codes = [finding["code"] for finding in refusal.findings]
            op.result = "LEASE_MISSING" if "LEASE_MISSING" in codes else codes[0]
            op.end = time.monotonic()
        except ClientError:
            op.result = op.result or "lost"
            op.end = min(op.end, time.monotonic())
            op.fate = op.fate or "lost"
            raise
        finally:
            op.kept = time.monotonic()

    def _begun(self, op: Op, id: str) -> None:
        with self._lock:
            op.motion = id
            self._motions[id] = op

    # ----------------------------------------------------------------------- who watches

    def _watch(self) -> None:
        """Events of both fronts, with their gaps (H3)."""
        while not self._ended.is_set():
            last = None
            with (
                suppress(ClientError),
                Client(str(self.daemon.sockets), name="observe", timeout=2.0) as client,
            ):
                for message in client.stream("Monitor", topics=["events", "state"], rate=20.0):
                    self._watched.set()
                    if message["topic"] == "state":
                        if last is not None and message["dropped"] == 0 and message["time"] - last > 1.0:
                            self.gaps.append(f"no state from {last} to {message['time']}")
                        last = message["time"]
                    else:
                        self._note(message["event"])
                    if self._ended.is_set():
                        return
            time.sleep(0.05)

    def _note(self, event: dict[str, object]) -> None:
        self.events += 1
        name = str(event["id"])
        phase = str(event["phase"])
        if event["code"] == "MOTION" and phase in ENDS:
            codes = tuple(finding["code"] for finding in event["findings"])  # type: ignore[attr-defined]
            with self._lock:
                self._ends[name] = (phase, codes)
