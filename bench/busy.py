"""`busy.*`: motions and armings on a machine whose cores all compute, under a socket storm.

The robot moves without end and is armed anew at intervals. What a stall of the machine itself may have caused
is counted apart. `MINUTES` in the environment (or `--minutes`) says how long.
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.base_commit import OWN, SourceTree, base_tree, own_tree
from bench.c_servos import on_c_servos
from bench.daemon import BenchDaemon, scratch
from bench.harness import FigureSpec, MeasuredFigure, Measurement, quantile
from bench.motion import swing
from bench.stalls import StallLog, sentinel
from twind.client import Client, Refused

MINUTES = "MINUTES"  # environment variable
REARM = 10.0  # s between two armings
AGES = 0.2  # s between two looks at the readings
SHORT = 1.0  # s: a refused motion or arming is tried again after this
COMPUTING = "while True: sum(range(1000))"


@dataclass
class BusyCount:
    """Armings and motions of one daemon. Times are monotonic, s."""

    armings: int = 0
    motions: int = 0
    aborted: list[float] = field(default_factory=list)
    refused: list[float] = field(default_factory=list)
    unaccepted: int = 0  # motions that were refused, with a reason
    faults: int = 0  # armings that found a fault latched, which was then reset
    ages: list[float] = field(default_factory=list)  # ms, of the oldest reading in each look
    codes: dict[str, int] = field(default_factory=dict)  # of what aborted or refused
    policy: str = ""

    def blame(self, findings: Sequence[Mapping[str, Any]]) -> None:
        """Count the codes of one refusal or abortion."""
        for code in {each["code"] for each in findings}:
            self.codes[code] = self.codes.get(code, 0) + 1


def take() -> Mapping[str, MeasuredFigure]:
    """Both trees, one after the other, each for the whole time."""
    span = 60.0 * float(os.environ.get(MINUTES) or 1.0)
    with scratch() as folder, base_tree(folder) as base:
        trees = (own_tree(), base)
        found = {tree.name: _one(tree, folder, span) for tree in trees}
    figures = {}
    for kind in ("aborted", "refused"):
        apart = {name: _parted(getattr(count, kind), log) for name, (count, log) in found.items()}
        notes = [_note(name, count, kind, apart[name][1]) for name, (count, _) in found.items()]
        note = f"{span / 60:g} min; {'; '.join(notes)}; {found[own_tree().name][1].note()}"
        own = float(apart[own_tree().name][0])
        figures[f"busy.{kind}"] = MeasuredFigure(own, note, {f"base {base.name}": float(apart[base.name][0])})
    return figures


def _parted(times: Sequence[float], log: StallLog) -> tuple[int, int]:
    """Count those of `times` that lie in seconds without, and with a stall."""
    stalled = sum(log.between(at - 1.0, at) for at in times)
    return len(times) - stalled, stalled


def _note(name: str, count: BusyCount, kind: str, stalled: int) -> str:
    whole = count.motions if kind == "aborted" else count.armings
    text = f"{name}: of {whole}, {stalled} in stalled seconds apart, {count.unaccepted} motions refused, "
    text += f"{count.faults} faults reset, "
    ages = f"{quantile(count.ages, 0.99):.0f} ms" if count.ages else "—"
    text += f"readings' age p99 {ages}, policy {count.policy}"
    return text + f", {count.codes}" * bool(count.codes)


def _one(tree: SourceTree, folder: Path, span: float) -> tuple[BusyCount, StallLog]:
    count = BusyCount()
    with ExitStack() as stack:
        log = stack.enter_context(sentinel(folder, 0.01))
        daemon = stack.enter_context(on_c_servos(tree, folder, tree.built_in_robot("h24")))
        # Both connect before the storm takes all places of the socket.
        client = stack.enter_context(daemon.client())
        looker = stack.enter_context(daemon.client())
        status = client.call("GetStatus", joints=True)
        count.policy = status["status"]["loop"]["realtime"]["scheduler"]
        stack.enter_context(_disturbed(daemon, [joint["name"] for joint in status["joints"]]))
        until = time.monotonic() + span
        looking = threading.Thread(target=_look, args=(looker, count, until))
        looking.start()
        try:
            while time.monotonic() < until:
                _armed_once(client, count, until)
        finally:
            looking.join()
    return count, log


@contextmanager
def _disturbed(daemon: BenchDaemon, joints: Sequence[str]) -> Iterator[None]:
    """A computing process for each core, and a socket storm."""
    commands = [[sys.executable, "-c", COMPUTING] for _ in os.sched_getaffinity(0)]
    commands += [[sys.executable, "-m", "bench.socket_storm", str(daemon.sockets), ",".join(joints)]]
    processes = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=OWN)
        for command in commands
    ]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()
            assert process.stdin is not None
            process.stdin.close()


def _armed_once(client: Client, count: BusyCount, until: float) -> None:
    """Arm, move until `REARM` s are over, disarm."""
    count.armings += 1
    try:
        client.call("AcquireLease")
        client.call("Arm")
    except Refused as refusal:
        if any(each["code"] == "FAULT_LATCHED" for each in refusal.findings):
            # The abortion that latched it is counted already; an operator resets it and goes on.
            count.armings -= 1
            count.faults += 1
            _reset(client)
            return
        count.refused.append(time.monotonic())
        count.blame(refusal.findings)
        time.sleep(SHORT)
        return
    begin = time.monotonic()
    path = _shortened(swing(client.call("GetStatus", joints=True)["joints"]))
    while time.monotonic() < min(until, begin + REARM):
        _move(client, path, count)
    client.call("Disarm")


def _reset(client: Client) -> None:
    """Switch torque off and reset what is latched."""
    for method in ("Disarm", "Reset"):
        with suppress(Refused):
            client.call(method)
    time.sleep(SHORT)


def _shortened(path: dict[str, Any]) -> dict[str, Any]:
    """The first two points: a motion of two seconds, there and back."""
    return {**path, "points": path["points"][:2]}


def _move(client: Client, path: dict[str, Any], count: BusyCount) -> None:
    """One motion to its end."""
    try:
        *_, last = client.stream("SubmitTrajectory", trajectory=path)
    except Refused as refusal:
        count.unaccepted += 1
        count.blame(refusal.findings)
        time.sleep(SHORT)
        return
    count.motions += 1
    if last.get("phase") != "succeeded":
        count.aborted.append(time.monotonic())
        count.blame(last.get("findings") or ())


def _look(client: Client, count: BusyCount, until: float) -> None:
    """Keep the age of the oldest reading, again and again."""
    while time.monotonic() < until:
        joints = client.call("GetStatus", joints=True)["joints"]
        ages = [joint["age_ms"] for joint in joints if joint["age_ms"] is not None]
        count.ages.append(max(ages, default=0.0))
        time.sleep(AGES)


MEASUREMENTS = (
    Measurement({"busy.aborted": FigureSpec("count", "0"), "busy.refused": FigureSpec("count", "0")}, take),
)
