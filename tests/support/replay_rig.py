"""A recording played back under the fake clock: the real loop before the bytes of a file, in one process.

`recording` and `flight` are the other half: recordings that take no time.
"""

import os
import socket
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from tests.support.daemon_rig import HandFront, Rig
from twind import link, sealed_memfd
from twind.briefing import Briefing
from twind.config.calibration_file import save_calibration
from twind.config.config_files import ConfigSources, describe
from twind.config.file_changes import fingerprints
from twind.flight import FlightRing, LoadedFlight, read
from twind.front.joint_naming import JointNames
from twind.loop.bus.bus_opener import BusOpener
from twind.loop.ipc.front_link import FrontLink
from twind.loop.process.service_notify import Notifier
from twind.loop.tick import assembly
from twind.loop.tick.bound_robot import BoundRobot
from twind.observe.replaying.device_state_tracker import story
from twind.observe.replaying.replay_bus import ReplayBus
from twind.observe.replaying.replay_files import lay_out
from twind.observe.replaying.replay_outcome import RunOutcome
from twind.observe.replaying.replay_script import SIM, STAY, RecordedCommand, ReplayScript, outcome, score
from twind.observe.replaying.replay_servos import ReplayPosition
from twind.robot.modes import Mode
from twind.safety.gate import GateThresholds
from twind.twin.binding import bind
from twind_drivers.bus import BusReader, PortError
from twind_drivers.clock import FakeClock
from twind_drivers.virtual.serial_loopback import Loopback

LEAD = 2.0  # s until the recording begins: identified and armed
LATE = 0.02  # share by which a value may differ: what is found a tick later has grown
WAY = 0.012  # rad: of a joint that moves 0.2 rad/s, in a round of the slow registers
MISSED = 1 / 8  # share of the errors of a bus: a recorded daemon missed ticks, which this clock does not
AFTER = 0.05  # s that the replay goes on beyond the recording, for answers that come a tick later


def recording(robot: str = "h24", **options: Any) -> Rig:
    """A rig that writes a flight recorder."""
    return Rig(robot, ring=FlightRing.create(16 << 20), **options)


def flight(rig: Rig, folder: Path) -> LoadedFlight:
    """Content so far, as a flight file has it."""
    calibrated = save_calibration(rig.calibration, folder, rig.robot.name)
    files = fingerprints([rig.robot.path, rig.robot.mjcf_path, calibrated])
    fd = assembly.make_briefing(rig.one, rig.robot.rate_hz, {}, "info", files)
    briefing = msgspec.msgpack.decode(sealed_memfd.unseal(fd), type=Briefing)
    os.close(fd)
    assert rig.recorder is not None
    return LoadedFlight(
        {}, msgspec.structs.replace(briefing, binding=b"", described=b""), read(rig.recorder.fd)
    )


def figures(asked: ReplayScript, begin: float, news: Sequence[Any]) -> dict[str, Any]:
    """Figures of a loop since `begin` (s): its findings, buses and last goals."""
    tickets = {each.command.ticket for each in asked.commands if isinstance(each.command, link.Command)}
    replies = [each for each in news if isinstance(each, link.Reply) and each.ticket in tickets]
    overviews = [each for each in news if isinstance(each, link.Overview)]
    before = next((each for each in reversed(overviews) if each.time <= begin), overviews[0])
    ticks = [each for each in news if isinstance(each, link.Tick) and each.time >= begin]
    goals = zip(asked.names, np.frombuffer(ticks[-1].goal, "<f8").tolist(), strict=True)
    errors = zip(before.buses, overviews[-1].buses, strict=True)
    return {
        "findings": [[each["code"], each.get("value"), each.get("bound")] for each in _findings(replies)],
        "errors": {now.name: now.errors - then.errors for then, now in errors},
        "goals": {name: round(goal, 4) for name, goal in goals if goal == goal},
    }


def _findings(replies: Sequence[link.Reply]) -> Iterator[Mapping[str, Any]]:
    for each in replies:
        plain = msgspec.to_builtins(each.parameters)
        yield from plain.get("findings") or ()
        yield from (plain.get("verdict") or {}).get("refusals") or ()


def unlike(then: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """Differences between the figures of a recording and those of its replay, in words."""
    rows = [[(code, bound) for code, _, bound in each["findings"]] for each in (then, now)]
    if rows[0] != rows[1]:
        yield f"findings and bounds: recorded {rows[0]}, replayed {rows[1]}"
    else:
        for (code, old, bound), (_, new, _) in zip(then["findings"], now["findings"], strict=True):
            if (old is None) != (new is None) or (old is not None and abs(new - old) > LATE * abs(old)):
                yield f"{code}: recorded {old} (bound {bound}), replayed {new}"
    for bus, errors in then["errors"].items():
        if abs(now["errors"][bus] - errors) > 1 + MISSED * errors:
            yield f"errors of bus {bus}: recorded {errors}, replayed {now['errors'][bus]}"
    if then["goals"].keys() != now["goals"].keys():
        yield f"goals: recorded {list(then['goals'])}, replayed {list(now['goals'])}"
        return
    for joint, goal in then["goals"].items():
        if abs(now["goals"][joint] - goal) > WAY:
            yield f"goal of {joint}: recorded {goal}, replayed {now['goals'][joint]}"


class Replay:
    """`run` plays a recording into a loop and says what came out."""

    def __init__(self, flight: LoadedFlight, folder: Path) -> None:
        self.score: ReplayScript = score(flight)
        files = lay_out(flight.briefing, folder)
        ports = tuple(f"{bus['name']}=/dev/no-{bus['name']}" for bus in flight.briefing.description["buses"])
        self.described = describe(
            ConfigSources(
                config=str(files.config),
                mode=self.score.mode,
                robot=str(files.robot),
                calibration=None if files.calibration is None else str(files.calibration),
                ports=ports,
            )
        )
        robot = self.described.robot
        self.clock = FakeClock(1000.0)
        self.passage = ReplayPosition(self.score.begin, LEAD)
        self.told: Mapping[str, ReplayBus] = {
            bus.name: ReplayBus(
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
        one = BoundRobot(robot, self.described.calibration, bind(robot, self.described.calibration))
        self.buses = BusOpener(robot, one.binding.joint_map, {}, self.described.rate_hz)
        self.front = HandFront()
        self.loop = assembly.build(
            one,
            mode=Mode(self.score.mode),
            rate_hz=self.described.rate_hz,
            clock=self.clock,
            where={bus.name: f"told:{bus.name}" for bus in robot.buses},
            opener=self._open,
            enabler=self.buses.enable,
            link=FrontLink(self.front),  # type: ignore[arg-type]
            notifier=Notifier({}),
            thresholds=GateThresholds(),
            realtime={},
        )
        self.news: list[Any] = []
        self._deadline = self.clock.now()
        self._ticket = 1 << 40  # of calls that were not recorded

    def _open(self, name: str) -> BusReader:
        if not self.told[name].is_plugged:
            raise PortError(name, "no such port")
        return self.buses.reader(name, Loopback(self.told[name], self.clock))

    def run(self) -> RunOutcome:
        """Prepare, play, and what came of it."""
        self._until(lambda: self.loop.condition.state in ("connected", "disconnected") and self._known())
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
        waiting = list(self.score.asked)
        half = self.loop.robot.period / 2.0
        while self.passage.moment(self._deadline) < self.score.end + AFTER:
            moment = self.passage.moment(self._deadline)
            while waiting and waiting[0].time <= moment + half and not self._stays(waiting[0], moment):
                self._ask(waiting.pop(0))
            self._tick()
        begin = self.score.begin + self.passage.shift
        news = [each for each in self.news if getattr(each, "time", begin) >= begin]
        commands = [each.command for each in self.score.asked if isinstance(each.command, link.Command)]
        return outcome(JointNames(self.score.names), begin, commands, news)

    @property
    def verbatim(self) -> float:
        """Share of the questions that had their recorded answers."""
        told = self.told.values()
        return sum(bus.verbatim for bus in told) / max(1, sum(bus.verbatim + bus.made for bus in told))

    def figures(self) -> dict[str, Any]:
        """Figures of the result."""
        return figures(self.score, self.score.begin + self.passage.shift, self.news)

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
            f"{self.loop.condition.state}: {[e.message for e in self.news if isinstance(e, link.Event)]}"
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
        fd = sealed_memfd.seal("path", data)
        socket.send_fds(self.front.outer, [link.encode(command)], [fd])
        os.close(fd)

    def _stays(self, asked: RecordedCommand, moment: float) -> bool:
        """A client does not hang up yet: it had answers by then that may come a little later now."""
        if not isinstance(asked.command, link.ConnectionClosed) or moment >= asked.time + STAY:
            return False
        heard = {each.ticket: not each.continues for each in self.news if isinstance(each, link.Reply)}
        return self.score.stays(asked.command.client, heard)

    def _ask(self, asked: RecordedCommand) -> None:
        command = asked.command
        if isinstance(command, link.Submit):
            checked = command.front_checked and command.front_checked + self.passage.shift
            command = msgspec.structs.replace(command, front_checked=checked, generation=0)
        self._send(command, asked.data)

    def _tick(self) -> None:
        self._deadline = max(self._deadline, self.clock.now())
        self.clock.sleep_until(self._deadline)
        self.loop.run(until=self.clock.now() + 1e-9)
        self._deadline += self.loop.robot.period
        while True:
            try:
                self.news.append(link.decode_news(self.front.outer.recv(link.DATAGRAM)))
            except (BlockingIOError, OSError):
                return
