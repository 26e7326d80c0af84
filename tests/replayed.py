"""A recording played back under the fake clock: the real loop before the bytes of a file, in one process.

`recording` and `flight` are the other half: recordings that take no time.
"""

import os
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rig import HandFront, Rig

from twind import link, memfd
from twind.briefing import Briefing
from twind.config.calibration_file import save_calibration
from twind.config.edited import fingerprints
from twind.config.files import Sources, describe
from twind.flight import Flight, Ring, read
from twind.front.naming import Names
from twind.loop import assembly
from twind.loop.described import Robot
from twind.loop.link import Link
from twind.loop.notify import Notifier
from twind.loop.open_bus import Buses
from twind.observe.replaying.bus import ToldBus
from twind.observe.replaying.outcome import Outcome
from twind.observe.replaying.score import SIM, Asked, Score, outcome, score
from twind.observe.replaying.servos import Passage
from twind.observe.replaying.stage import lay_out
from twind.observe.replaying.story import story
from twind.robot.modes import Mode
from twind.safety.gate import Thresholds
from twind.twin.binding import bind
from twind_drivers.bus import PortError, Reader
from twind_drivers.clock import FakeClock
from twind_drivers.virtual.loopback import Loopback

LEAD = 2.0  # s until the recording begins: identified and armed
AFTER = 0.05  # s that the replay goes on beyond the recording, for answers that come a tick later


def recording(robot: str = "h24", **options: Any) -> Rig:
    """A rig that writes a flight recorder."""
    return Rig(robot, ring=Ring.create(16 << 20), **options)


def flight(rig: Rig, folder: Path) -> Flight:
    """What it holds by now, as a file of it would."""
    calibrated = save_calibration(rig.calibration, folder, rig.robot.name)
    files = fingerprints([rig.robot.path, rig.robot.mjcf_path, calibrated])
    fd = assembly.brief(rig.one, rig.robot.rate_hz, {}, "info", files)
    briefing = msgspec.msgpack.decode(memfd.unseal(fd), type=Briefing)
    os.close(fd)
    assert rig.recorder is not None
    return Flight({}, msgspec.structs.replace(briefing, binding=b"", described=b""), read(rig.recorder.fd))


class Replay:
    """`run` plays a recording into a loop and says what came out."""

    def __init__(self, flight: Flight, folder: Path) -> None:
        self.score: Score = score(flight)
        files = lay_out(flight.briefing, folder)
        ports = tuple(f"{bus['name']}=/dev/null" for bus in flight.briefing.description["buses"])
        self.described = describe(
            Sources(
                config=str(files.config),
                mode=self.score.mode,
                robot=str(files.robot),
                calibration=None if files.calibration is None else str(files.calibration),
                ports=ports,
            )
        )
        robot = self.described.robot
        self.clock = FakeClock(1000.0)
        self.passage = Passage(self.score.begin, LEAD)
        self.told: Mapping[str, ToldBus] = {
            bus.name: ToldBus(
                story(bus.name, place, flight.contents),
                self.passage,
                baud=bus.baud,
                period=1.0 / self.described.rate_hz,
                armed=self.score.armed,
                now=self.clock.now,
                leads=place == 0,
            )
            for place, bus in enumerate(robot.buses)
            if self.score.mode != SIM
        }
        one = Robot(robot, self.described.calibration, bind(robot, self.described.calibration))
        self.buses = Buses(robot, one.binding.joint_map, {}, self.described.rate_hz)
        self.front = HandFront()
        self.loop = assembly.build(
            one,
            mode=Mode(self.score.mode),
            rate_hz=self.described.rate_hz,
            clock=self.clock,
            where={bus.name: f"told:{bus.name}" for bus in robot.buses},
            opener=self._open,
            enabler=self.buses.enable,
            link=Link(self.front),  # type: ignore[arg-type]
            notifier=Notifier({}),
            thresholds=Thresholds(),
            realtime={},
        )
        self.news: list[Any] = []
        self._deadline = self.clock.now()
        self._ticket = 1 << 40  # of calls that were not recorded

    def _open(self, name: str) -> Reader:
        if not self.told[name].plugged:
            raise PortError(name, "no such port")
        return self.buses.reader(name, Loopback(self.told[name], self.clock))

    def run(self) -> Outcome:
        """Prepare, play, and what came of it."""
        self._until(lambda: self.loop.state in ("connected", "disconnected") and self._known())
        client = self.score.holder or 1 << 40
        if self.score.armed or self.score.holder:
            self._call(link.AcquireLease, client=client)
        if self.score.armed:
            self._call(link.Arm, client=client)
        if not self.score.holder:
            self._call(link.ReleaseLease, client=client)
        self.passage.ready = True
        if self.score.mode == SIM:
            self.passage.go(self._deadline, self.score.begin)
        while not self.passage.running:
            if self.score.holder:
                self._send(link.RenewLease(ticket=0, client=client))
            self._tick()
        waiting, half = list(self.score.asked), self.loop.period / 2.0
        while self.passage.moment(self._deadline) < self.score.end + AFTER:
            moment = self.passage.moment(self._deadline)
            while waiting and waiting[0].time <= moment + half:
                self._ask(waiting.pop(0))
            self._tick()
        begin = self.score.begin + self.passage.shift
        news = [each for each in self.news if getattr(each, "time", begin) >= begin]
        commands = [each.command for each in self.score.asked if isinstance(each.command, link.Command)]
        return outcome(Names(self.score.names), begin, commands, news)

    def close(self) -> None:
        self.loop.close()

    def _known(self) -> bool:
        return self.score.mode == "sim" or bool(np.isfinite(self.loop.hardware.slow.health_time).all())

    def _until(self, done: Any) -> None:
        for _ in range(1000):
            self._tick()
            if done():
                return
        raise AssertionError(
            f"{self.loop.state}: {[e.message for e in self.news if isinstance(e, link.Event)]}"
        )

    def _call(self, kind: Any, **fields: Any) -> None:
        self._ticket += 1
        ticket = self._ticket
        self._send(kind(ticket=ticket, **fields))

        def answered() -> bool:
            found = [each for each in self.news if isinstance(each, link.Reply) and each.ticket == ticket]
            assert not found or found[-1].error is None, found[-1]
            return bool(found)

        self._until(answered)

    def _send(self, command: Any, data: bytes = b"") -> None:
        if not data:
            self.front.outer.send(link.encode(command))
            return
        fd = memfd.seal("path", data)
        socket.send_fds(self.front.outer, [link.encode(command)], [fd])
        os.close(fd)

    def _ask(self, asked: Asked) -> None:
        command = asked.command
        if isinstance(command, link.Submit):
            checked = command.front_checked and command.front_checked + self.passage.shift
            command = msgspec.structs.replace(command, front_checked=checked, generation=0)
        self._send(command, asked.data)

    def _tick(self) -> None:
        self._deadline = max(self._deadline, self.clock.now())
        self.clock.sleep_until(self._deadline)
        self.loop.run(until=self.clock.now() + 1e-9)
        self._deadline += self.loop.period
        while True:
            try:
                self.news.append(link.decode_news(self.front.outer.recv(link.DATAGRAM)))
            except (BlockingIOError, OSError):
                return
