"""One injection judged: detection by what was told, reaction by what servos did, the bus by the monitor.

Whatever is not as it must be goes to `wrong`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from tests.proof.faults.fault import Fault, Outcome
from tests.proof.faults.robot import AWAY, BRAKE, LONGEST, QUIET, REST, STILL, TICK, Robot
from twind import link
from twind.robot.modes import RobotState

LAG = 0.03  # s that a servo may be behind a goal that moves, besides (docs/reason-codes.md, FOLLOW_ERR)
NEAR = "LOOKAHEAD_COLLISION"  # random motions may bring the feet near each other ...
SLOWER = ": slower"  # and are slowed (LOOKAHEAD_COLLISION): a held motion is not on the way of its row


class World(Robot):
    """A robot, and what must be seen of it."""

    # ------------------------------------------------------------------------------------ detection

    def blame(self, what: str) -> None:
        self.wrong.append(f"{self.now:.3f} s: {what}")

    def claim(self, right: bool, what: str) -> None:
        if not right:
            self.blame(what)

    def first_report(self, codes: Iterable[str] | None = None, since: float | None = None) -> float | None:
        """Time of the first of the codes since the injection, s."""
        wanted = set(codes if codes is not None else self.fault.codes)
        since = since or self.begun
        times = [
            event.time
            for event in self.events
            if event.time >= since - 1e-6
            and (event.code in wanted or any(finding.code in wanted for finding in event.findings))
        ]
        return min(times, default=None)

    def detected(
        self, bound: float | None = None, since: float | None = None, codes: Sequence[str] | None = None
    ) -> bool:
        """Time passes until it is told: within the bound, counted from `since`. The delay is kept."""
        bound = self.fault.bound if bound is None else bound
        since = self.begun if since is None else since
        if not self.until(lambda: self.first_report(codes) is not None, since + bound + 0.3 - self.now):
            said = sorted({event.code for event in self.events if event.time >= self.begun})
            self.blame(f"not told within {bound * 1e3:.0f} ms; told was {said}")
            return False
        told = self.first_report(codes)
        assert told is not None
        self.outcome.bound = bound
        self.outcome.delay = max(self.outcome.delay or 0.0, told - since)
        self.claim(told - since <= bound + 1e-6, f"told after {told - since:.3f} s, bound {bound:.3f} s")
        return True

    def behind(self, far: float, lasting: float, seconds: float = 8.0) -> float | None:
        """Time passes until a shaft has been that far (rad) from the last goal sent, and what a moving goal
        may be ahead, for so long (s) without a break, or until a fault holds it; when that began."""
        rig = self.rig
        since = np.full(len(self.rig.truth), np.inf)
        before = rig.loop.robot.written
        for _ in range(round(seconds / rig.loop.robot.period)):
            self.ticks(1)
            if rig.loop.robot.written is not None and before is not None:
                ahead = LAG * np.abs(rig.loop.robot.written - before) / rig.loop.robot.period
                far_off = np.abs(rig.loop.robot.written - rig.truth) > far + ahead
                if rig.loop.condition.latches:  # it is held, and the gap closed
                    return float(min(since.min(), self.now))
                since = np.where(far_off, np.minimum(since, self.now), np.inf)
                if self.now - since.min() >= lasting:
                    return float(since.min())
            before = rig.loop.robot.written
        return None

    @property
    def rejected(self) -> int:
        """Count what was dropped so far: bytes, and exchanges without a reply of some device."""
        return sum(port.counts.discarded + port.counts.errors for port in self.rig.loop.hardware.ports)

    def counted(self, before: int) -> bool:
        """Claim that what is dropped is counted, reported or not; like `detected`, within the bound."""
        bound = self.fault.bound
        if not self.until(lambda: self.rejected > before, self.begun + bound + 0.3 - self.now):
            self.blame("neither told nor counted")
            return False
        delay = self.now - self.begun
        self.outcome.delay = delay
        self.claim(delay <= bound + 1e-6, f"counted after {delay:.3f} s, bound {bound:.3f} s")
        return True

    # ------------------------------------------------------------------------------------ reactions

    def rows(self, but: Iterable[int] = ()) -> NDArray[np.bool_]:
        """(m,) all actuators but these places, in the order of the trace."""
        found = np.ones(sum(len(bus.ids()) for bus in self.rig.virtual.values()), np.bool_)
        found[list(but)] = False
        return found

    def of_bus(self, name: str) -> list[int]:
        """Places of the actuators of a bus."""
        at = 0
        found = list[int]()
        for bus in self.rig.virtual.values():
            count = len(bus.ids())
            found += range(at, at + count) if bus.name == name else ()
            at += count
        return found

    def holds(self, since: float, seconds: float = 0.4, but: Iterable[int] = ()) -> None:
        """From then on goals stand still and shafts with them, and torque is on."""
        rows = self.rows(but)
        self.seconds(max(0.0, since + seconds + 0.02 - self.now))
        goal = self.trace.goal(since, since + seconds)[:, rows]
        place = self.trace.place(since + 0.2, since + seconds)[:, rows]
        self.claim(len(goal) > 9 and len(place) > 9, "too short a look at a hold")
        self.claim(bool((np.ptp(goal, axis=0) == 0).all()), "goals go on after the robot should hold")
        self.claim(bool((np.ptp(place, axis=0) <= STILL).all()), "shafts go on after the robot should hold")
        self.torque_stays(but)

    def stands(self, since: float, seconds: float = 0.3, but: Iterable[int] = ()) -> None:
        """From then on shafts stand still, whatever the goals: the servos stop by themselves."""
        rows = self.rows(but)
        self.seconds(max(0.0, since + seconds + 0.02 - self.now))
        place = self.trace.place(since, since + seconds)[:, rows]
        self.claim(
            len(place) > 9 and bool((np.ptp(place, axis=0) <= STILL).all()),
            "shafts go on after the servos should stop",
        )

    def torque_stays(self, but: Iterable[int] = (), until: float = np.inf) -> None:
        """Since the injection nobody (but those) lost torque."""
        torque = self.trace.torque(self.begun, until)[:, self.rows(but)]
        self.claim(bool((torque == 1).all()), "torque went off where it must stay")

    def settles(self, within: float = 6.5, but: Iterable[int] = ()) -> None:
        """To the rest pose under torque, then off."""
        rows = self.rows(but)
        off = self.until(lambda: not self.rig.register("torque_enable")[rows].any(), within)
        self.claim(off, f"torque is still on {within} s later")
        torque = self.trace.torque(self.begun)[:, rows]
        on = np.flatnonzero((torque == 1).all(axis=1))
        last = on[-1] if on.size else 0
        place = self.trace.place(self.begun)[last]
        far = self._angles(place)[rows]
        self.claim(bool((far <= REST).all()), f"torque went off {far.max():.2f} rad from the rest pose")

    def comes_down(self, within: float, but: Iterable[int] = ()) -> None:
        """Without torque in the end: never away from the rest pose, unless damped before and said so."""
        rows = self.rows(but)
        self.until(lambda: not self.rig.register("torque_enable")[rows].any(), within)
        (self.settles if self.first_report(("DAMP",)) is None else self.sinks)(0.1, but)

    def sinks(self, within: float = 10.0, but: Iterable[int] = ()) -> None:
        """Soft, said so, and then without torque: what stands by itself with a joint that carries nothing."""
        rows = self.rows(but)
        off = self.until(lambda: not self.rig.register("torque_enable")[rows].any(), within)
        self.claim(off, f"torque is still on {within} s later")
        self.claim(self.first_report(("DAMP",)) is not None, "it was not damped before torque went off")

    def _angles(self, counts: NDArray) -> NDArray:
        """(m,) rad from the rest pose, bus after bus."""
        names = [j.name for bus in self.rig.robot.buses for j in self.rig.made.joints(bus.name)]
        joints = {joint.name: joint for joint in self.rig.robot.joints}
        rest = dict(zip(self.rig.names, self.rig.loop.robot.rest, strict=True))
        found = []
        for name, ticks in zip(names, counts, strict=False):
            joint = joints[name]
            turn = 2.0 * np.pi / joint.type.ticks_per_turn
            angle = (ticks - self.rig.zeros[name]) * joint.sign / joint.ratio * turn
            found.append(abs(angle - rest[name]))
        return np.array(found + [0.0] * (len(counts) - len(found)))  # a twin has no joint

    def trips(self, since: float, but: Iterable[int] = ()) -> None:
        """Every servo's own watchdog stops it within 120 ms of the last packet, torque on."""
        self.seconds(max(0.0, since + 0.2 - self.now))
        rows = self.rows(but)
        self.claim(bool((self.rig.register("bus_watchdog") == 255)[rows].all()), "a watchdog did not trip")
        delays = np.concatenate([bus.servos.trip_delay for bus in self.rig.virtual.values()])[rows]
        self.claim(bool((delays <= 0.12).all()), f"watchdogs tripped up to {delays.max():.3f} s late")

    def goes_on(self, seconds: float = 1.5) -> None:
        """The motion was not touched: goals and shaft of the joint still move."""
        since = self.now
        row = self.row(self.joint)
        self.seconds(seconds)
        goal = self.trace.goal(since)[:, row]
        place = self.trace.place(since)[:, row]
        self.claim(np.ptp(goal) > 10 and np.ptp(place) > 10, "the motion ended")
        self.torque_stays()

    def row(self, joint: int) -> int:
        """Place of a joint in the trace."""
        spec = self.rig.robot.joints[joint]
        return self.of_bus(spec.bus)[list(self.rig.virtual[spec.bus].ids()).index(spec.id)]

    # ------------------------------------------------------------------------------------ recovery

    def stays_so(self, seconds: float = 1.0) -> None:
        """Nobody gets torque by itself, and no goal is written into who has none."""
        since = self.now
        self.seconds(max(seconds, 0.02))
        torque = self.trace.torque(since)
        goal = self.trace.goal(since)
        self.claim(not (np.diff(torque, axis=0) > 0).any(), "torque came on by itself")
        left = ~self.trace.ours(since)[:-1] & ~self.trace.ours(since)[1:]
        written = (np.diff(goal, axis=0) != 0) & (torque[:-1] == 0) & left
        self.claim(not written.any(), "goals are written to limp servos that nobody arms")

    def latched(self, *codes: str) -> None:
        """One of these is latched, so that nothing can be armed before a reset."""
        found = set(self.rig.loop.condition.latches)
        self.claim(bool(found & set(codes or self.fault.codes)), f"not latched; latched is {sorted(found)}")

    def recover(self) -> None:
        """Torque off, acknowledged, servos that shut down restarted, armed, moving: by commands alone."""
        rig = self.rig
        try:
            self._down()
            for _ in range(2):
                for name, bus in rig.virtual.items():
                    for row in np.flatnonzero(bus.servos["hardware_error_status"]).tolist():
                        self.call(link.Reboot, bus=name, id=bus.servos.registers.id_of(row))
                        self.ticks(5)
                self.seconds(1.1)
            connected = self.until(lambda: rig.loop.condition.state is RobotState.CONNECTED, 5.0)
            assert connected, f"state {rig.loop.condition.state.value} after a reset"
            self.arm()
            self.joint = int(self.random.integers(len(rig.names)))
            self.move()
            since = self.now
            moved = 0.0
            for _ in range(4):  # it may lie near the first knot, which others take longer to reach
                if moved <= 20:
                    self.seconds(1.5)
                    moved = np.ptp(self.trace.place(since)[:, self.row(self.joint)])
            assert moved > 20, (
                f"armed again, and the shaft of {rig.names[self.joint]} moves {moved:.0f} ticks"
            )
        except AssertionError as error:
            self.blame(f"no way back: {error}")

    def _down(self) -> None:
        rig = self.rig
        self.until(lambda: rig.loop.procedures.rank is None, 12.0)
        if self.random.random() < 0.5:
            self.call(link.EStop, level="cut")
        else:
            self.call(link.Disarm, seconds=14.0)
        self.until(lambda: rig.loop.procedures.rank is None, 12.0)
        if rig.loop.condition.latches:
            reply = self.call(link.Reset)
            assert reply.error is None, reply

    # ------------------------------------------------------------------------------------ verdict

    def finish(self) -> Outcome:
        """Nothing else was said, nothing on the bus was against the rules, no reading was a lie."""
        if self.rig is None:
            return self.outcome
        others: dict[str, str] = {}
        for event in self.events:
            slowed = event.code == NEAR and event.message.endswith(SLOWER)
            if event.level not in QUIET and event.code not in self.also and not slowed:
                others.setdefault(event.code, f"{event.time:.3f} s, {event.message}")
        for code, message in others.items():
            self.wrong.append(f"other: {code}: {message}")
        self.tap.look()
        self.wrong += [f"bus: {each}" for each in self.tap.wrong[:5]]
        if self.judge is not None:
            self.wrong += [f"reading: {each}" for each in self.judge.wrong[:5]]
        return self.outcome


def once(fault: Fault, seed: int) -> Outcome:
    """One injection under the fake clock. An exception is a wrong outcome, with its seed."""
    world = (fault.world or World)(fault, seed)
    try:
        assert fault.virtual is not None
        fault.virtual(world)
        return world.finish()
    except Exception as error:
        world.wrong.append(f"the run itself failed: {error!r}"[:600])
        return world.finish()
    finally:
        world.close()


__all__ = ["AWAY", "BRAKE", "LONGEST", "TICK", "World", "once"]
