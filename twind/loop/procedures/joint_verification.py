"""Verification of joints: present, as calibrated, turn known, no fault since. Loop's process.

The turn of a device is chosen after its identification, from readings that agree, and never while this
daemon's torque is on. Missing devices of the same bus do not matter. Until then the position of the joint is
unknown: NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np

from twind.loop.bus.bus_port import BusPort, PortState
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.torque_readback import torque_known
from twind.robot.arrays import Bools, Floats, Ints, every, frozen, some
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_map import JointBusMap
from twind.robot.measured_travel import MeasuredTravel
from twind.robot.modes import Mode
from twind.safety.device_rules import ALERT
from twind.safety.guard import Guard
from twind.safety.multiturn import StatedPlace, chosen, fits_twice, inside, outside_travel, unfit

AGREEING = 3  # readings in a row with the same turn; a single wrong reading would place the joint a turn away
SILENT = 0.1  # s without readings in which a limp device may have restarted: a boot takes longer
READINGS = 3.5  # likewise, in periods: at a low rate one lost reply is no silence
ASTRAY = 1.0  # s outside its travel, without torque, after which another turn is chosen if one fits


class JointVerificationState:
    """Verification state of each joint; arrays are (n,)."""

    def __init__(self, context: ProcedureContext, guard: Guard) -> None:
        count = len(context.robot.joints)
        self.mismatches: tuple[Finding, ...] = ()  # devices that differ from the calibration (CALIB_MISMATCH)
        self.unrestored: Finding | None = None  # servo that an end-stop search has not restored yet
        self._context = context
        self._guard = guard
        self._answered: Bools = np.zeros(count, np.bool_)  # device identified and matching
        self._turn_known: Bools = np.zeros(count, np.bool_)  # turn known since the identification
        # restarted or with a hardware error since the identification
        self._marred: Bools = np.zeros(count, np.bool_)
        # silent since the last identification for so long that it may have restarted, or be another device
        self._away: Bools = np.zeros(count, np.bool_)
        self._absent = False  # a device is
        self._since: Floats = np.full(count, inf)  # s, since when its bus is identified
        self._turn: Ints = np.zeros(count, np.int64)  # ticks, the turn of the last reading ...
        # ... and the number of readings in a row that agree with it
        self._agreeing: Ints = np.zeros(count, np.int64)
        self._astray: Floats = np.full(count, inf)  # s, since when
        self._places: dict[int, StatedPlace] = {}  # places from which a turn is to be chosen
        self._links = [PortState.CLOSED] * len(context.hardware.ports)
        # bus -> findings on joints whose turn is unknown or unusable
        self._unfit: dict[str, Sequence[Finding]] = {}
        context.hardware.readings.placed = self._turn_known.copy()

    @property
    def joints(self) -> Bools:
        """Mask (n,) of the joints that are verified now."""
        context = self._context
        found = np.array(context.robot.joints.calibrated, np.bool_) & self._turn_known & ~self._marred
        for port, bus in context.hardware.pairs:
            if port.link is not PortState.CONNECTED:
                found[bus.joints] = False
        for finding in (*self.mismatches, *self.findings()):
            if finding.joint is not None:
                found[finding.joint] = False
        return found

    @property
    def unjudged(self) -> Bools:
        """Mask (n,) of the joints whose turn has not been determined yet, neither chosen nor refused."""
        waiting = ~self._turn_known
        waiting[[_joint(each) for found in self._unfit.values() for each in found]] = False
        return waiting

    def findings(self) -> list[Finding]:
        """Findings on joints that are not verified, as far as no other part reports them.

        Empty while this daemon's torque is on.
        """
        found = self.doubts()
        context = self._context
        if context.torque.armed or context.condition.mode is Mode.SIM or not context.hardware.connected:
            return found
        listed = {finding.joint for finding in (*found, *self._guard.bars)}
        waits = self.unjudged
        for joint in np.flatnonzero(self._marred | waits).tolist():
            if joint not in listed:
                found.append(self._waiting_for(joint))
        return found

    def _waiting_for(self, joint: int) -> Finding:
        """Return why a joint with a known device is not verified yet."""
        fault = self._context.hardware.slow.fault
        if not self._marred[joint]:
            message = "its turn is not known yet: wait"
        elif self._guard.devices.kept_errors(fault)[joint]:
            return self._guard.devices.hardware_error(joint, int(fault[joint]))
        else:
            message = "was silent, restarted or had an error: wait until it has been identified anew"
        return Finding(ReasonCode.CALIB_MISMATCH, joint, message=message)

    def doubts(self) -> list[Finding]:
        """Return findings on joints that are not where they report, as far as no other part reports it.

        Empty while this daemon's torque is on, and in mode sim.
        """
        context = self._context
        if context.torque.armed or context.condition.mode is Mode.SIM:
            return []
        found = [finding for findings in self._unfit.values() for finding in findings]
        found += [] if self.unrestored is None else [self.unrestored]
        turns = context.robot.joints.turns
        readings = context.hardware.readings
        if turns is not None:
            found += outside_travel(readings.raw.ticks, readings.shift, turns, self._turn_known)
        return found

    def locate(self, joint: int, place: StatedPlace) -> Finding | None:
        """Let a place choose the turn of a joint some ticks later; return a finding where it contradicts.

        A known turn is only compared with the place.
        """
        context = self._context
        turns = context.robot.joints.turns
        assert turns is not None
        raw = int(context.hardware.readings.raw.ticks[joint])
        whole = int(turns.whole[joint])
        if (finding := place.contradiction(joint, raw, whole)) is not None:
            return finding
        if not self._turn_known[joint]:
            self._places[joint] = place
            self._agreeing[joint] = 0
        elif place.shift(raw, whole) != context.hardware.readings.shift[joint]:
            text = f"its turn is known, and {place.source} puts it on another one: nothing was changed"
            return Finding(ReasonCode.CALIB_MISMATCH, joint, message=text)
        return None

    def withdraw(self, joints: Sequence[int]) -> list[int]:
        """Forget places that have not chosen a turn yet; return their joints."""
        return [joint for joint in joints if self._places.pop(joint, None) is not None]

    def waiting(self, joints: Sequence[int]) -> bool:
        """Return whether a place has not chosen the turn of one of these joints yet."""
        return any(joint in self._places for joint in joints)

    def refused_turns(self, joints: Sequence[int]) -> list[Finding]:
        """Return the findings on these joints whose turn is unknown or unusable."""
        found = [each for findings in self._unfit.values() for each in findings]
        return [each for each in found if each.joint in joints]

    def ambiguous_turn(self, joint: int) -> Finding | None:
        """Return the finding on a joint whose turn is unknown only as several fit; None: another case."""
        turns = self._context.robot.joints.turns
        raw = self._context.hardware.readings.raw.ticks
        if turns is None or self._turn_known[joint] or not fits_twice(raw, turns)[joint]:
            return None
        return next(iter(self.refused_turns([joint])), None)

    @property
    def turn_known(self) -> Bools:
        """Mask (n,) of the joints whose turn is known."""
        return self._turn_known.copy()

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
        self._turn_known[rows] &= fits & (not port.holding)  # those held by this daemon are checked anew
        bad = self._guard.devices.faulty(self._context.hardware.slow.fault)[rows]
        self._marred[rows] = np.where(fits, bad, self._marred[rows])

    def watch(self, now: float) -> None:
        """Choose the turns of identified devices that are not known yet; called once per tick."""
        context = self._context
        turns = self._context.robot.joints.turns
        self._process_link_changes(now)
        if self._absent or not every(context.robot.measured.heard):
            self._suspect_returned(now)
        # no identification while the robot is lowered
        if some(self._marred) and context.procedures.rank is None:
            self._identify_healed()
        if turns is None:
            self._turn_known |= self._answered
        else:
            if some(turns.ambiguous):
                self._doubt_silent(turns, now)
            if not (context.torque.armed or context.torque.energising) and some(self._turn_known):
                self._recheck_turns(turns, now)
            if not every(self._turn_known):
                self._count(turns)
                for number, (port, bus) in enumerate(context.hardware.pairs):
                    self._choose(number, port, bus.joints, turns)
        self._place()

    def _process_link_changes(self, now: float) -> None:
        """Forget the turns of the joints on a bus that was lost, or is identified anew.

        They may be on another turn. Joints that this daemon holds with torque keep their turn when identified
        anew.
        """
        for number, (port, bus) in enumerate(self._context.hardware.pairs):
            anew = port.link is PortState.IDENTIFYING and self._links[number] is PortState.CONNECTED
            if (anew and not port.holding) or port.link is PortState.CLOSED:
                self._answered[bus.joints] = False
                self._doubt(bus.joints)
                self._unfit.pop(port.name, None)
            self._links[number] = port.link
            if port.link is not PortState.CONNECTED:
                self._since[bus.joints] = now
                self._away[bus.joints] = False

    def _suspect_returned(self, now: float) -> None:
        """Mark devices that answer again after a silence as marred, once torque is off.

        Most families do not report a restart. Their settings may be gone, or another device may have the id.
        """
        context = self._context
        if context.torque.inhibited:  # the daemon itself is silent
            return
        silence = np.minimum(context.robot.measured.age, now - self._since)
        silent = silence > max(SILENT, READINGS * context.robot.period)
        self._away |= silent
        if some(self._away) and not (context.torque.armed or context.torque.energising):
            self._marred |= self._away & ~silent
        self._absent = some(self._away)

    def _doubt(self, joints: Ints) -> None:
        self._turn_known[joints] = False
        self._agreeing[joints] = 0
        for joint in joints.tolist():
            self._places.pop(joint, None)

    def _identify_healed(self) -> None:
        """Identify anew the buses of devices that answer, and whose hardware error is gone.

        Such a device may have restarted, or be another one. An unknown error (-1) may be gone: what is left
        of it is read with the alert, or by the order to switch torque on (RobStride).
        """
        readings = self._context.hardware.readings
        faulty = self._guard.devices.faulty(self._context.hardware.slow.fault)
        heard = self._context.robot.measured.heard
        healed = self._marred & heard & (readings.alerts & ALERT == 0) & ~faulty
        for port, bus in self._context.hardware.pairs:
            # a restart on request restores the settings first, and is answered
            if port.link is PortState.CONNECTED and some(healed[bus.joints]) and not port.tasks:
                port.identify()

    def _recheck_turns(self, turns: MeasuredTravel, now: float) -> None:
        """Choose anew the turn of joints that jumped by half a turn or more, or stay out of their travel.

        The latter only where another turn fits. Either a reading was wrong, or the servo has lost its turns.
        """
        hardware = self._context.hardware
        raw = hardware.readings.raw.ticks
        readings = hardware.readings
        outside = self._turn_known & ~inside(raw + readings.shift, turns)
        if some(outside) or some(readings.jumps):
            self._astray = np.where(outside, np.minimum(self._astray, now), inf)
            # one that another turn would place inside too is no proof that this one is wrong
            long = (now - self._astray >= ASTRAY) & (torque_known(self._context) == 0) & ~turns.long
            leapt = (readings.jumps > 0) & (2 * readings.leaps >= turns.whole * hardware.resolution)
            anew = (long & inside(raw + chosen(raw, turns), turns)) | (leapt & turns.known)
            self._doubt(np.flatnonzero(self._turn_known & anew))
        else:
            self._astray[:] = inf

    def _doubt_silent(self, turns: MeasuredTravel, now: float) -> None:
        """Doubt the turns of silent joints that a restart could place on another turn of their travel."""
        silent = now - self._context.hardware.readings.heard_at > SILENT
        self._doubt(np.flatnonzero(self._turn_known & turns.ambiguous & silent))

    def _count(self, turns: MeasuredTravel) -> None:
        """Count the readings in a row that give the same turn."""
        raw = self._context.hardware.readings.raw.ticks
        turn = chosen(raw, turns)
        for joint, place in self._places.items():
            turn[joint] = place.shift(int(raw[joint]), int(turns.whole[joint]))
        fresh = self._context.robot.measured.heard
        again = np.where(turn == self._turn, self._agreeing, 0) + 1
        self._agreeing = np.where(fresh, again, self._agreeing)
        self._turn = np.where(fresh, turn, self._turn)

    def _choose(self, number: int, port: BusPort, rows: Ints, turns: MeasuredTravel) -> None:
        context = self._context
        hardware = self._context.hardware
        raw = hardware.readings.raw.ticks
        before = hardware.readings.shift
        due = np.zeros_like(self._turn_known)
        due[rows] = (self._answered & ~self._turn_known & (self._agreeing >= AGREEING))[rows]
        if not some(due):
            return
        shift = np.where(due, self._turn, before)
        placed = np.zeros_like(due)
        placed[list(self._places)] = True
        found = [
            each for each in unfit(raw, shift, turns, torque_known(context) == 1, placed) if due[_joint(each)]
        ]
        # By the readings that choose: the limp joint may have been moved since the place was compared.
        against = [
            place.contradiction(joint, int(raw[joint]), int(turns.whole[joint]))
            for joint, place in self._places.items()
            if due[joint]
        ]
        found += [each for each in against if each is not None]
        self._places = {joint: place for joint, place in self._places.items() if not due[joint]}
        due[_joints(found)] = False
        shift = np.where(due, shift, before)
        held = port.holding or context.torque.energising
        self._turn_known |= due & (shift == before) & ~hardware.left_out if held else due
        self._report_unverified(port.name, found)
        if not held and some(shift != before):
            hardware.turn(number, shift[rows])

    def _place(self) -> None:
        """Mark joints without a known turn as unknown; joints that get goals keep their position."""
        context = self._context
        hardware = self._context.hardware
        placed = self._turn_known if every(self._turn_known) else self._turn_known | hardware.energised_joints
        for _, bus in hardware.pairs:
            for each in bus.linked:  # known only with all of its actuators
                mates = bus.joints[each.rows]
                placed = placed.copy()
                placed[mates] = every(placed[mates])
        if not np.array_equal(placed, hardware.readings.placed):
            hardware.readings.placed = placed.copy()
            context.robot.measured = replace(
                context.robot.measured, position=frozen(hardware.readings.where())
            )

    def _report_unverified(self, bus: str, found: Sequence[Finding]) -> None:
        """Report once for the same joints, however their readings change."""
        if set(map(_joint, found)) - set(map(_joint, self._unfit.get(bus, ()))):
            self._context.reports.event("warning", found[0].code, found[0].message, tuple(found))
        self._unfit[bus] = found


def _joint(finding: Finding) -> int:
    assert finding.joint is not None
    return finding.joint


def _joints(findings: Sequence[Finding]) -> list[int]:
    return [finding.joint for finding in findings if finding.joint is not None]
