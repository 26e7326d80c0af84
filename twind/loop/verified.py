"""Who is verified: present, as it was calibrated, its turn known, unharmed since. Loop's process.

The turn is chosen when a bus has been identified, from where its joints stand, and never while torque of ours
is on: until then who has to be on another turn than before is not verified.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from twind.loop.ports import Link, Port
from twind.robot.arrays import Bools, Ints, every, frozen, some
from twind.robot.finding import Code, Finding
from twind.robot.joints import BusMap
from twind.robot.modes import Mode
from twind.safety.device_rules import ALERT
from twind.safety.turns import chosen, strayed, unfit

if TYPE_CHECKING:
    from twind.loop.tick import Loop


class Verified:
    """Joint by joint; arrays are (n,)."""

    def __init__(self, loop: Loop) -> None:
        count = len(loop.parts.joints)
        self._loop = loop
        self._told: Bools = np.zeros(count, np.bool_)  # whose turn is known since it was identified
        self._marred: Bools = np.zeros(count, np.bool_)  # who restarted or had a hardware error since
        self._unfit: dict[str, Sequence[Finding]] = {}  # bus -> whose turn cannot be told, or not be used

    @property
    def joints(self) -> Bools:
        """Who is verified now."""
        loop = self._loop
        found = np.array(loop.joints.calibrated, np.bool_) & self._told & ~self._marred
        for port, bus in loop.hardware.pairs:
            if port.link is not Link.CONNECTED:
                found[bus.joints] = False
        for finding in (*loop.identity.mismatches, *self.findings()):
            if finding.joint is not None:
                found[finding.joint] = False
        return found

    @property
    def unjudged(self) -> Bools:
        """Whose turn nobody has looked at yet: what they read says nothing of where they are."""
        waiting = ~self._told
        waiting[[_joint(each) for found in self._unfit.values() for each in found]] = False
        return waiting

    def findings(self) -> list[Finding]:
        """Why joints are not, as far as nobody else says it; while torque is ours nothing."""
        loop = self._loop
        if loop.armed or loop.mode is Mode.SIM or not loop.hardware.connected:
            return []
        found = [finding for findings in self._unfit.values() for finding in findings]
        found += loop.homing.findings()
        turns, readings = loop.joints.turns, loop.hardware.readings
        if turns is not None and every(self._told):
            found += strayed(readings.raw.ticks, readings.shift, turns)
        said = {finding.joint for finding in (*found, *loop.parts.guard.bars)}
        for joint in np.flatnonzero(self._marred).tolist():
            if joint not in said:
                message = "restarted, or had a hardware error: wait until it has been identified anew"
                found.append(Finding(Code.CALIB_MISMATCH, joint, message=message))
        return found

    def mar(self, findings: Sequence[Finding]) -> None:
        """What restarted, or has a hardware error, is not verified until it has been identified anew."""
        self._marred[[finding.joint for finding in findings if finding.joint is not None]] = True

    def identified(self, port: Port, bus: BusMap) -> None:
        """Everybody of that bus has said who they are: their turns are chosen anew."""
        self._told[bus.joints] = False
        self._marred[bus.joints] = self._loop.hardware.slow.fault[bus.joints] > 0
        self._unfit.pop(port.name, None)
        self.watch()

    def watch(self) -> None:
        """Once per tick: choose the turns that are not known yet, of buses that are identified."""
        if some(self._marred):
            self._ask_again()
        if every(self._told):
            return
        for number, (port, bus) in enumerate(self._loop.hardware.pairs):
            if port.link is Link.CONNECTED and not every(self._told[bus.joints]):
                self._choose(number, port, bus.joints)

    def _ask_again(self) -> None:
        """Who had a hardware error and has none any more: it may have restarted, or be another one."""
        readings, slow = self._loop.hardware.readings, self._loop.hardware.slow
        healed = self._marred & (readings.alerts & ALERT == 0) & (slow.fault == 0)
        for port, bus in self._loop.hardware.pairs:
            if port.link is Link.CONNECTED and some(healed[bus.joints]):
                port.identify()

    def _choose(self, number: int, port: Port, rows: Ints) -> None:
        loop, hardware = self._loop, self._loop.hardware
        turns, raw, before = loop.joints.turns, hardware.readings.raw.ticks, hardware.readings.shift
        if turns is None:
            self._told[rows] = True
            return
        due = np.zeros_like(self._told)
        due[rows] = ~self._told[rows] & loop.measured.heard[rows]
        shift = np.where(due, chosen(raw, turns), before)
        found = [each for each in unfit(raw, shift, turns, loop.torque_known == 1) if due[_joint(each)]]
        due[list(map(_joint, found))] = False
        shift = np.where(due, shift, before)
        ours = port.holding or loop.energising
        self._told |= due & (shift == before) if ours else due
        self._say(port.name, found)
        if not ours and some(shift != before):
            hardware.turn(number, shift[rows], np.where(turns.falls, 0, shift)[rows])
            loop.measured = replace(loop.measured, position=frozen(hardware.readings.position))

    def _say(self, bus: str, found: Sequence[Finding]) -> None:
        """Once of the same joints, however their readings flicker."""
        if set(map(_joint, found)) - set(map(_joint, self._unfit.get(bus, ()))):
            self._loop.say.event("warning", found[0].code, found[0].message, tuple(found))
        self._unfit[bus] = found


def _joint(finding: Finding) -> int:
    assert finding.joint is not None
    return finding.joint
