"""Verification of joints: present, as calibrated, its turn known, unharmed since. Loop's process.

The turn of a device is chosen after its identification, from readings that agree, and never while this
daemon's torque is on. Other missing devices of its bus do not matter. Until then the position of its joint is
unknown: NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from twind.loop.bus_port import BusPort, PortState
from twind.robot.arrays import Bools, Floats, Ints, every, frozen, some
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joints import JointBusMap
from twind.robot.modes import Mode
from twind.safety.device_rules import ALERT
from twind.safety.multiturn import chosen, inside, strayed, unfit

if TYPE_CHECKING:
    from twind.loop.tick import Loop
    from twind.robot.turn_range import TurnRange

AGREEING = 3  # readings in a row that must say the same turn
ASTRAY = 1.0  # s out of its travel, limp, after which another turn is taken if one fits


class JointVerification:
    """Verification state of each joint; arrays are (n,)."""

    def __init__(self, loop: Loop) -> None:
        count = len(loop.parts.joints)
        self._loop = loop
        self._answered: Bools = np.zeros(count, np.bool_)  # who said who it is, and fits
        self._told: Bools = np.zeros(count, np.bool_)  # whose turn is known since then
        self._marred: Bools = np.zeros(count, np.bool_)  # who restarted or had a hardware error since
        self._turn: Ints = np.zeros(count, np.int64)  # ticks, what the last reading says ...
        self._agreeing: Ints = np.zeros(count, np.int64)  # ... and so many before it said too
        self._astray: Floats = np.full(count, inf)  # s, since when
        self._links = [PortState.CLOSED] * len(loop.hardware.ports)
        self._unfit: dict[str, Sequence[Finding]] = {}  # bus -> whose turn cannot be told, or not be used
        loop.hardware.readings.placed = self._told.copy()

    @property
    def joints(self) -> Bools:
        """Mask (n,) of the joints that are verified now."""
        loop = self._loop
        found = np.array(loop.joints.calibrated, np.bool_) & self._told & ~self._marred
        for port, bus in loop.hardware.pairs:
            if port.link is not PortState.CONNECTED:
                found[bus.joints] = False
        for finding in (*loop.identity.mismatches, *self.findings()):
            if finding.joint is not None:
                found[finding.joint] = False
        return found

    @property
    def unjudged(self) -> Bools:
        """Mask (n,) of the joints whose turn has not been determined yet, neither chosen nor refused."""
        waiting = ~self._told
        waiting[[_joint(each) for found in self._unfit.values() for each in found]] = False
        return waiting

    def findings(self) -> list[Finding]:
        """Findings on joints that are not verified, as far as no other part reports them.

        Empty while this daemon's torque is on.
        """
        found = self.doubts()
        loop = self._loop
        if loop.armed or loop.mode is Mode.SIM or not loop.hardware.connected:
            return found
        said = {finding.joint for finding in (*found, *loop.parts.guard.bars)}
        waits = self.unjudged
        for joint in np.flatnonzero(self._marred | waits).tolist():
            if joint not in said:
                message = "restarted, or had a hardware error: wait until it has been identified anew"
                message = message if self._marred[joint] else "nobody knows yet which turn it is on: wait"
                found.append(Finding(ReasonCode.CALIB_MISMATCH, joint, message=message))
        return found

    def doubts(self) -> list[Finding]:
        """Return findings on joints that are not where they report, as far as no other part reports it.

        Empty while this daemon's torque is on, and in mode sim.
        """
        loop = self._loop
        if loop.armed or loop.mode is Mode.SIM:
            return []
        found = [finding for findings in self._unfit.values() for finding in findings]
        found += loop.homing.findings()
        turns = loop.joints.turns
        readings = loop.hardware.readings
        if turns is not None:
            found += strayed(readings.raw.ticks, readings.shift, turns, self._told)
        return found

    def mar(self, findings: Sequence[Finding]) -> None:
        """Mark devices with a hardware error: not verified until identified anew."""
        self._marred[_joints(findings)] = True

    def restarted(self, findings: Sequence[Finding]) -> None:
        """Mark devices that have restarted in the same way; their turns may be gone too."""
        self.mar(findings)
        self._doubt(np.array(_joints(findings), np.int64))

    def identified(self, port: BusPort, bus: JointBusMap, fits: Bools) -> None:
        """Process an identification of that bus; `fits` (m,): the device answered and is the right one.

        A device that did not answer may be at any position when it is back.
        """
        rows = bus.joints
        self._answered[rows] = fits
        self._told[rows] &= fits & (not port.holding)  # those that we hold are looked at anew
        bad = self._loop.hardware.slow.fault[rows] > 0
        self._marred[rows] = np.where(fits, bad, self._marred[rows])

    def watch(self, now: float) -> None:
        """Choose the turns of identified devices that are not known yet; called once per tick."""
        loop = self._loop
        turns = self._loop.joints.turns
        self._look_at_links()
        if some(self._marred) and loop.procedures.rank is None:  # nobody is asked on a way down
            self._ask_again()
        if turns is None:
            self._told |= self._answered
        else:
            if not (loop.armed or loop.energising) and some(self._told):
                self._look_astray(turns, now)
            if not every(self._told):
                self._count(turns)
                for number, (port, bus) in enumerate(loop.hardware.pairs):
                    self._choose(number, port, bus.joints, turns)
        self._place()

    def _look_at_links(self) -> None:
        """Forget the turns of the joints on a bus that was lost, or is identified anew.

        They may be on another turn. Joints that this daemon holds with torque keep theirs when identified
        anew.
        """
        for number, (port, bus) in enumerate(self._loop.hardware.pairs):
            anew = port.link is PortState.IDENTIFYING and self._links[number] is PortState.CONNECTED
            if (anew and not port.holding) or (
                port.link is PortState.CLOSED and some(self._answered[bus.joints])
            ):
                self._answered[bus.joints] = False
                self._doubt(bus.joints)
                self._unfit.pop(port.name, None)
            self._links[number] = port.link

    def _doubt(self, joints: Ints) -> None:
        self._told[joints] = False
        self._agreeing[joints] = 0

    def _ask_again(self) -> None:
        """Identify anew the buses of devices whose hardware error is gone.

        Such a device may have restarted, or be another one.
        """
        readings = self._loop.hardware.readings
        slow = self._loop.hardware.slow
        healed = self._marred & (readings.alerts & ALERT == 0) & (slow.fault == 0)
        for port, bus in self._loop.hardware.pairs:
            if port.link is PortState.CONNECTED and some(healed[bus.joints]):
                port.identify()

    def _look_astray(self, turns: TurnRange, now: float) -> None:
        """Choose anew the turn of joints that jumped by half a turn or more, or stay out of their travel.

        The latter only where another turn fits. Either a reading was wrong, or the servo has lost its turns.
        """
        hardware = self._loop.hardware
        raw = hardware.readings.raw.ticks
        readings = hardware.readings
        outside = self._told & ~inside(raw + readings.shift, turns)
        if some(outside) or some(readings.jumps):
            self._astray = np.where(outside, np.minimum(self._astray, now), inf)
            long = (now - self._astray >= ASTRAY) & (self._loop.torque_known == 0)
            leapt = (readings.jumps > 0) & (2 * readings.leaps >= turns.whole * hardware.resolution)
            anew = (long & inside(raw + chosen(raw, turns), turns)) | (leapt & turns.known)
            self._doubt(np.flatnonzero(self._told & anew))
        else:
            self._astray[:] = inf

    def _count(self, turns: TurnRange) -> None:
        """Count the readings in a row that give the same turn."""
        turn = chosen(self._loop.hardware.readings.raw.ticks, turns)
        heard = self._loop.measured.heard
        again = np.where(turn == self._turn, self._agreeing, 0) + 1
        self._agreeing = np.where(heard, again, self._agreeing)
        self._turn = np.where(heard, turn, self._turn)

    def _choose(self, number: int, port: BusPort, rows: Ints, turns: TurnRange) -> None:
        loop = self._loop
        hardware = self._loop.hardware
        raw = hardware.readings.raw.ticks
        before = hardware.readings.shift
        due = np.zeros_like(self._told)
        due[rows] = (self._answered & ~self._told & (self._agreeing >= AGREEING))[rows]
        if not some(due):
            return
        shift = np.where(due, self._turn, before)
        found = [each for each in unfit(raw, shift, turns, loop.torque_known == 1) if due[_joint(each)]]
        due[_joints(found)] = False
        shift = np.where(due, shift, before)
        ours = port.holding or loop.energising
        self._told |= due & (shift == before) & ~hardware.left_out if ours else due
        self._report_unverified(port.name, found)
        if not ours and some(shift != before):
            hardware.turn(number, shift[rows])
            loop.measured = replace(loop.measured, position=frozen(hardware.readings.where()))

    def _place(self) -> None:
        """Where everybody else is, nobody knows; who gets goals of ours is where it was."""
        loop = self._loop
        hardware = self._loop.hardware
        placed = self._told if every(self._told) else self._told | hardware.energised_joints
        for _, bus in hardware.pairs:
            for each in bus.linked:  # by all of its actuators
                mates = bus.joints[each.rows]
                placed = placed.copy()
                placed[mates] = every(placed[mates])
        if not np.array_equal(placed, hardware.readings.placed):
            hardware.readings.placed = placed.copy()
            loop.measured = replace(loop.measured, position=frozen(hardware.readings.where()))

    def _report_unverified(self, bus: str, found: Sequence[Finding]) -> None:
        """Report once for the same joints, however their readings change."""
        if set(map(_joint, found)) - set(map(_joint, self._unfit.get(bus, ()))):
            self._loop.say.event("warning", found[0].code, found[0].message, tuple(found))
        self._unfit[bus] = found


def _joint(finding: Finding) -> int:
    assert finding.joint is not None
    return finding.joint


def _joints(findings: Sequence[Finding]) -> list[int]:
    return [finding.joint for finding in findings if finding.joint is not None]
