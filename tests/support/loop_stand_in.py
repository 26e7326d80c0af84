"""A stand-in for the loop: speaks the link for real, to a real front process, and records what it is asked.

It has no robot. What it answers to a command is what the test tells it to (`answers`), `{}` otherwise.
"""

import array
import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from twind import link, sealed_memfd
from twind.briefing import Briefing, JointInfo
from twind.config.robot_file import load_robot
from twind.listening_sockets import BACKLOG
from twind.robot.finding import Finding, ReasonCode
from twind.twin.binding import bind
from twind.twin.binding_transfer import packed
from twind.version import __version__

NAMES = [f"joint_{place}" for place in range(24)]
Answer = Callable[[link.Command], list[link.Reply]]


def briefing(count: int = 24) -> Briefing:
    joints = [JointInfo(name, "main", place + 1, True, -1.0, 1.0) for place, name in enumerate(NAMES[:count])]
    return Briefing(
        version=__version__,
        robot="stand-in",
        joints=joints,
        description={"name": "stand-in", "gate": {"on_velocity": "reject"}},
        calibration=None,
        mjcf="<mujoco/>",
        binding=packed(bind(load_robot("h24"), None)) if count == 24 else b"",
        rate_hz=100.0,
        parameters={"latency_warn_ms": 50},
    )


def tick(now: float, sequence: int, count: int = 24) -> link.Tick:
    place = np.arange(count, dtype=np.float64)
    age = np.full(count, 0.01)
    age[-1] = np.inf
    position = place / 10.0
    position[-1] = np.nan
    return link.Tick(
        time=now,
        sequence=sequence,
        mode="live",
        state="armed",
        motion="holding",
        armed=True,
        inherited=False,
        position=position.tobytes(),
        velocity=(0.0 * place).tobytes(),
        effort=np.full(count, np.nan).tobytes(),
        age=age.tobytes(),
        heard=np.array([True] * (count - 1) + [False]).tobytes(),
        goal=(place / 10.0).tobytes(),
        simulated=(place / 10.0).tobytes(),
        read=now - 0.003,
        raw=(2048 - 100 * place).astype(np.int64).tobytes(),
        raw_effort=np.where((place == 1) | ~np.isfinite(age), np.nan, -place).tobytes(),
        raw_age=age.tobytes(),
        skew=0.0015,
    )


def overview(now: float, ticks: int = 0, count: int = 24) -> link.Overview:
    torque = np.array([1] * (count - 2) + [0, -1], np.int8)
    bits = np.zeros(count, np.int16)
    bits[0] = 0b100000 | 0b100
    bits[-1] = -1
    whole = ticks % 100 == 1  # once a second, as the loop does
    runs = ([link.Bucket(0.05, ticks), link.Bucket(None, 1)], 7.5) if whole else (None, None)
    return link.Overview(
        time=now,
        latency_ms=2.5,
        latency_avg_ms=2.4,
        latency_max_ms=float("nan"),
        violations=0,
        skew_ms=1.5,
        skew_max_ms=2.5,
        hw_connected=True,
        sim_connected=True,
        lease=None,
        lease_client=0,
        faults=[Finding(ReasonCode.STATE_STALE, joint=3, value=0.2, bound=0.1)],
        buses=[link.BusInfo("main", "/dev/ttyUSB0", True, 1.5, None, 0.4, 1000, 2)],
        loop=link.LoopInfo(100.0, ticks, 0, 1.0, 40.0, 80.0, 200.0, {"policy": "other"}, *runs),
        latencies=[link.LatencyInfo("bus", 1.5, 1.5, 0.1, 1.4, 1.9, 1.5, 1.8, 0, *runs)],
        temperature=np.full(count, 40.0).tobytes(),
        voltage=np.full(count, 12.0).tobytes(),
        torque=torque.tobytes(),
        fault_bits=bits.tobytes(),
        verified=np.array([True] * (count - 1) + [False]).tobytes(),
    )


class StandIn:
    """A loop without a robot, and the front it started."""

    def __init__(
        self,
        directory: Path,
        *,
        rate: float = 100.0,
        stderr: int | None = None,
        program: tuple[str, ...] = ("-m", "twind.front"),
        binding: bytes | None = None,
        goal: bytes | None = None,
        given_briefing: Briefing | None = None,
    ) -> None:
        """`binding`: handed over instead of h24's. `goal`: where the robot holds, float64 of 24 joints.
        `told`: the whole briefing, instead of one of joints without a robot."""
        self.directory = directory
        self.rate = rate
        self.goal = goal
        self.commands: list[link.Inward] = []
        self.paths: list[bytes] = []
        self.answers: dict[type, Answer] = {}
        self.armed = True
        self.lease_client = 0
        self.deaf = False  # reads nothing, so that the pipe fills
        self.heartbeats = 0
        self.inner, outer = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.inner.setblocking(False)
        given_briefing = briefing() if given_briefing is None else given_briefing
        given_briefing = (
            given_briefing if binding is None else msgspec.structs.replace(given_briefing, binding=binding)
        )
        fd = sealed_memfd.seal("briefing", msgspec.msgpack.encode(given_briefing))
        listeners = {name: self._listen(name) for name in ("control", "observe")}
        handed = {"link": outer.fileno(), "briefing": fd}
        handed |= {name: listener.fileno() for name, listener in listeners.items()}
        arguments = [part for name, number in handed.items() for part in (f"--{name}", str(number))]
        self.log = directory / "log"
        with self.log.open("wb") as log:
            self.front = subprocess.Popen(
                [sys.executable, *program, *arguments],
                pass_fds=list(handed.values()),
                stderr=log if stderr is None else stderr,
                start_new_session=True,
            )
        outer.close()
        os.close(fd)
        for listener in listeners.values():
            listener.close()
        self._running = True
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def await_lookahead(self, patience: float = 10.0) -> None:
        """Until the front has loaded its model: its memory has grown to what it will be."""
        end = time.monotonic() + patience
        while "LOOKAHEAD" not in self.log.read_text():
            assert time.monotonic() < end, self.log.read_text()
            time.sleep(0.01)

    def _listen(self, name: str) -> socket.socket:
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(str(self.directory / f"{name}.sock"))
        listener.listen(BACKLOG)
        return listener

    def close(self) -> int:
        """End as a loop ends; the front's exit status."""
        self._running = False
        self._thread.join(2.0)
        self.inner.close()
        return self.front.wait(5.0)

    def send(self, message: link.Outward) -> None:
        with contextlib.suppress(BlockingIOError):
            self.inner.send(link.encode(message))

    def _run(self) -> None:
        sequence = 0
        due = time.monotonic()
        while self._running:
            sequence += 1
            if not self.deaf:
                self._commands()
            now = time.monotonic()
            try:
                if sequence % 10 == 1:
                    whole = overview(now, sequence)
                    self.send(msgspec.structs.replace(whole, lease_client=self.lease_client))
                news = msgspec.structs.replace(tick(now, sequence), armed=self.armed)
                self.send(news if self.goal is None else msgspec.structs.replace(news, goal=self.goal))
            except OSError:
                return
            due += 1.0 / self.rate
            time.sleep(max(0.0, due - time.monotonic()))

    def _commands(self) -> None:
        while True:
            try:
                data, extra, _, _ = self.inner.recvmsg(link.DATAGRAM, 64)
            except OSError:
                return
            if not data:
                return
            fds = array.array("i")
            for _, _, payload in extra:
                fds.frombytes(payload)
            for fd in fds:
                self.paths.append(sealed_memfd.unseal(fd))
                os.close(fd)
            command = link.decode_command(data)
            if isinstance(command, link.Heartbeat):
                self.heartbeats += 1
                continue
            self.commands.append(command)
            if isinstance(command, link.Command):
                answer = self.answers.get(type(command), lambda c: [link.Reply(ticket=c.ticket)])
                for reply in answer(command):
                    self.send(reply)

    def await_command(self, kind: type, patience: float = 3.0) -> link.Inward:
        """The first command of a kind, once it has come."""
        return self.await_message(lambda command: isinstance(command, kind), patience)

    def await_message(self, wanted: Callable[[link.Inward], bool], patience: float = 3.0) -> link.Inward:
        """The first message that is wanted, once it has come."""
        end = time.monotonic() + patience
        while time.monotonic() < end:
            for command in list(self.commands):
                if wanted(command):
                    return command
            time.sleep(0.005)
        raise AssertionError(f"did not come within {patience} s; came: {self.commands}")
