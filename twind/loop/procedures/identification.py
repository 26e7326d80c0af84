"""Identification of the devices on each bus: ports that open and close, missing devices, wrong devices.

A device is wrong when it is not the calibrated one. The ports are checked after each exchange, and changes
become states and findings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from math import inf

import numpy as np

from twind.loop.bus.bus_port import IDENTIFY_AGAIN, BusPort, PortState
from twind.loop.procedures.joint_verification import JointVerificationState
from twind.loop.procedures.mode_entry import ModeEntry
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Priority
from twind.loop.procedures.torque_readback import torque_inherited, torque_off, torque_unreported
from twind.loop.procedures.torque_release import TorqueRelease
from twind.loop.procedures.torque_switching import retry_torque_off
from twind.robot.arrays import Bools, every, same, some
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_map import JointBusMap
from twind.robot.modes import Mode, RobotState
from twind.safety.state_machine import RobotEvent
from twind_drivers.bus import IdentifiedDevice

SILENT = 2.0  # s without a reply of any device: the bus counts as disconnected
GONE = 0.1  # s without a reply of any device: their power may have gone (docs/safety.md, a stale state)
UNREAD = 1.0  # s without a sound reading of a device that replies to identification
READINGS = 5  # readings that must have been tried before that is reported; one lost reading is no fault
LATE = (
    "replies come {0:.0f} to {1:.0f} ms after their request, too late to be read: set the adapter's latency "
    "timer to 1 ms (`echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer`) and the servos' "
    "return_delay_time to 5; `twindctl doctor` checks both"
)
DOUBLE = "two devices with this id? Stop the daemon: `twindctl scan --port PORT` shows them; disconnect one"
LOOK = 0.05  # s between two looks at an armed robot without a change
SPOKE = 0.05  # s: a device of a silent bus replied just now, so its power is back


class IdentificationState:
    """Identified devices and findings, bus by bus."""

    def __init__(
        self,
        context: ProcedureContext,
        verified: JointVerificationState,
        release: TorqueRelease,
        modes: ModeEntry,
    ) -> None:
        self.verified = verified
        self._context = context
        self._release = release
        self._modes = modes
        self._devices: dict[tuple[str, int], IdentifiedDevice] = {}
        self._again: dict[str, float] = {}
        self._gone: dict[str, float] = {}  # bus -> s without a reply of any device on it
        # bus -> devices that a patient identification has found
        self._waited: dict[str, frozenset[tuple[int, bool]]] = {}
        self._mute: set[str] = set()  # buses on which the last identification found no device
        self._reported: dict[
            str, str
        ] = {}  # bus -> the trouble, or the warning of an open port, last reported
        self._inherited_reported = False  # torque that was found on has been reported
        self._found_all = False  # all devices are present: the simulation may start at their positions
        # bus -> findings on missing devices and other models
        self.missing: dict[str, tuple[Finding, ...]] = {}
        # s, when an armed robot is looked at again though nothing changed; its torque as seen last
        self._next_look = -inf
        self._seen = b""

    @property
    def troubles(self) -> list[Finding]:
        """All findings that prevent arming, for the status."""
        missing = [finding for findings in self.missing.values() for finding in findings]
        return [*missing, *self.verified.mismatches, *self.verified.findings()]

    def watch(self, now: float) -> None:
        """Process the result of the exchange; called once per tick."""
        if self._is_settled(now):
            return
        context = self._context
        for lost in context.hardware.lost:
            self._on_bus_lost(lost.bus, str(lost.error), now)
        context.hardware.lost.clear()
        for port, bus in context.hardware.pairs:
            self._step_port(port, bus, now)
        self.verified.watch(now)
        self._place(context)
        self.settle_state(now)
        if torque_inherited(context) and not self._inherited_reported:
            message = "torque was found on; nothing is written until an operator arms or disarms"
            context.reports.event("warning", ReasonCode.TORQUE_INHERITED, message)
        self._inherited_reported = torque_inherited(context)

    def _is_settled(self, now: float) -> bool:
        """Check that nothing has changed on an armed robot; even then it is looked at 20 times a second."""
        context = self._context
        hardware = context.hardware
        if now < self._next_look and context.torque.armed and context.procedures.rank is None:
            torque = hardware.slow.torque
            new = hardware.lost or not same(torque, self._seen) or some(hardware.readings.jumps)
            # a silence is noted tick by tick: a bus that was silent for long is identified anew
            if not new and hardware.connected and not self._gone and every(context.robot.measured.heard):
                return True
        self._seen = hardware.slow.torque.tobytes()
        self._next_look = now + LOOK
        return False

    def settle_state(self, now: float) -> None:
        """Bring the robot's state in line with its ports."""
        context = self._context
        ports = context.hardware.ports
        if context.condition.mode is Mode.SIM or context.condition.state is RobotState.INHIBITED:
            return
        identified = context.hardware.connected
        if not identified and context.condition.state is RobotState.CONNECTED:
            context.condition.change(
                RobotEvent.PORT_LOST
            )  # a latched state keeps its own state until a reset
        if context.condition.state is RobotState.DISCONNECTED and any(port.reader for port in ports):
            context.condition.change(RobotEvent.PORT_OPENED)
        waits = context.condition.state in (RobotState.IDENTIFYING, RobotState.FAULT, RobotState.ESTOP)
        if identified and not context.condition.identified and waits:
            context.condition.change(RobotEvent.IDENTIFIED)
        if torque_off(context):
            context.torque.find_off()
        torque = context.torque
        idle = context.procedures.rank is None and context.condition.mode is Mode.LIVE
        due = torque.stop_level is not None or torque.unconfirmed
        if not idle or not due or context.condition.stop_wanted:
            return  # the end of the daemon switches it off, and must not be put off
        on = torque_inherited(context)
        unreported = torque_unreported(context)
        if torque.stop_level is not None and (on or (unreported and torque.stop_level == "cut")):
            self._release.stop(torque.stop_level)  # it came back with torque under a latched stop
        elif torque.unconfirmed and (on or unreported):
            context.procedures.own(Priority.DISARM, lambda: retry_torque_off(context))

    def restarted(self, findings: Sequence[Finding]) -> None:
        """Process servos that restarted (SERVO_REBOOTED).

        Settings and turns may be gone, so their buses are identified anew.
        """
        joints = {finding.joint for finding in findings}
        self.verified.restarted(findings)
        for port, bus in self._context.hardware.pairs:
            if not joints.isdisjoint(bus.joints.tolist()):
                port.identify()

    # ----------------------------------------------------------------------------- coming

    def _step_port(self, port: BusPort, bus: JointBusMap, now: float) -> None:
        context = self._context
        if port.link is PortState.CLOSED:
            if port.trouble and self._reported.get(port.name) != port.trouble:
                self._reported[port.name] = port.trouble
                context.reports.event("error", ReasonCode.PORT_UNAVAILABLE, port.trouble)
            return
        warning = port.warning
        if self._reported.get(port.name, "") != warning:
            self._reported[port.name] = warning
            if warning:
                context.reports.event("warning", EventCode.PORT_WARNING, f"{port.name}: {warning}")
        if port.link is PortState.CONNECTED:
            self._listen(port, context.hardware.readings.silence(bus, now))
        if port.link is PortState.IDENTIFYING:
            self._identify(port, bus, now)

    def _listen(self, port: BusPort, silence: float) -> None:
        """Identify a silent bus anew, also after a short silence.

        A servo that lost its power may have lost its settings and its turns.
        """
        before = self._gone.pop(port.name, 0.0)
        if silence > SILENT:
            message = f"{port.name}: no device answers any more: check power; all are identified anew"
        elif silence > GONE and not self._context.torque.inhibited:  # inhibited, the daemon itself is silent
            self._gone[port.name] = silence
            return
        elif before:
            message = (
                f"{port.name}: no device answered for {before:.2f} s: check power; all are identified anew"
            )
        else:
            return
        self._context.reports.event("error", ReasonCode.HW_DISCONNECTED, message)
        port.identify()

    def _identify(self, port: BusPort, bus: JointBusMap, now: float) -> None:
        task = port.identification
        if task is None:
            spoke = port.name in self._mute and self._context.hardware.readings.silence(bus, now) < SPOKE
            if spoke or now >= self._again.get(port.name, 0.0):
                port.identify()
            return
        if not task.done:
            return
        port.devices = task.result or ()
        slow = port.reader is not None and port.reader.lags
        unread = () if slow else tuple(self._unread(port, bus))
        if unread and port.readings < READINGS:
            return
        port.identification = None
        (self._mute.discard if port.devices else self._mute.add)(port.name)
        self._devices = {key: device for key, device in self._devices.items() if key[0] != port.name}
        self._devices |= {(port.name, device.id): device for device in port.devices}
        findings = (*self._unfit(port, bus), *unread)
        if findings or slow:
            if self._again_patiently(port):
                return
            findings += tuple(self._slow(bus)) if slow else ()
        if _differ(findings, self.missing.get(port.name, ()), late=port.late_reply is not None):
            self._report_findings("error", findings)
        self.missing[port.name] = findings
        port.tape.identified(whole=not findings)
        self.verified.identified(port, bus, self._fits(port, bus, findings))
        if findings:
            self._again[port.name] = now + IDENTIFY_AGAIN
            return
        port.link = PortState.CONNECTED
        self._found()

    def _fits(self, port: BusPort, bus: JointBusMap, findings: Sequence[Finding]) -> Bools:
        """Return the mask (m,) of the devices of this bus that are identified and match the robot file."""
        present = {device.id for device in port.devices}
        wrong = {finding.joint for finding in findings}
        rows = zip(bus.ids, bus.joints.tolist(), strict=True)
        return np.array([id in present and joint not in wrong for id, joint in rows], np.bool_)

    def _unfit(self, port: BusPort, bus: JointBusMap) -> Iterator[Finding]:
        """Yield a finding for each device of this bus that is silent, or does not match the robot file."""
        mine = set(bus.joints.tolist())
        for finding in self._context.robot.bound.judge(self._devices).refusals:
            if finding.joint in mine and finding.code == ReasonCode.DEVICE_MISMATCH:
                yield finding
            elif finding.joint in mine and finding.code == ReasonCode.DEVICE_MISSING:
                yield replace(finding, message=finding.message + _hint(port))

    def _again_patiently(self, port: BusPort) -> bool:
        """Identify again at once where a device is missing or was not read; return whether this was begun.

        It allows for the slowest setting of a servo (return delay 508 us). Where a patient identification
        found no more devices, it is not repeated.
        """
        found = frozenset((device.id, bool(device.settings)) for device in port.devices)
        if port.patient or self._waited.get(port.name) == found:
            if port.patient:
                self._waited[port.name] = found
            return False
        port.identify(patient=True)
        return True

    def _slow(self, bus: JointBusMap) -> Iterator[Finding]:
        """Yield the mismatches of a return delay that is longer than described.

        They count where the reading of the bus so takes longer than a tick.
        """
        mine = set(bus.joints.tolist())
        for finding in self._context.robot.bound.judge(self._devices).warnings:
            if finding.joint in mine and finding.code == ReasonCode.DEVICE_MISMATCH:
                yield finding

    def _unread(self, port: BusPort, bus: JointBusMap) -> Iterator[Finding]:
        """Yield a finding for each device that is identified but gives no sound reading.

        Two of one model identify themselves alike, and show different positions (fault matrix row 12).
        """
        present = {device.id for device in port.devices}
        age = self._context.robot.measured.age[bus.joints]
        for id, joint, unheard in zip(bus.ids, bus.joints.tolist(), ~(age < UNREAD), strict=True):
            if id in present and unheard:
                message = f"id {id} on bus {bus.name} answers, but not one of its readings is sound: "
                message += _late(port) or DOUBLE
                yield Finding(ReasonCode.DEVICE_MISSING, joint, message=message)

    def _found(self) -> None:
        """Process a bus whose devices are all present; with the last such bus, the robot is connected."""
        context = self._context
        if not context.hardware.connected:
            return
        verdict = self._context.robot.bound.judge(self._devices)
        self.verified.mismatches = verdict.refusals
        self._report_findings("warning", (*verdict.refusals, *verdict.warnings))
        self._found_all = True

    def _place(self, context: ProcedureContext) -> None:
        """Start the simulation from the measured pose, once that is known."""
        if self._found_all and np.isfinite(context.robot.measured.position).all():
            self._found_all = False
            if context.condition.mode is Mode.MIRROR and context.robot.untouched:
                self._modes.enter(context.condition.mode)

    def _report_findings(self, level: str, findings: Sequence[Finding]) -> None:
        """Report one event per code, however many joints it concerns."""
        for code, alike in groupby(sorted(findings, key=lambda each: each.code), key=lambda each: each.code):
            group = tuple(alike)
            self._context.reports.event(level, code, group[0].message, group)

    # ----------------------------------------------------------------------------- going

    def _on_bus_lost(self, bus: str, error: str, now: float) -> None:
        context = self._context
        finding = Finding(ReasonCode.PORT_LOST, message=f"{bus}: {error}")
        context.reports.event("error", ReasonCode.PORT_LOST, finding.message, (finding,))
        self._devices = {key: device for key, device in self._devices.items() if key[0] != bus}
        self.missing.pop(bus, None)
        self._gone.pop(bus, None)
        torque = context.torque
        armed = torque.armed
        # Torque off without a confirmation may be torque on: the other buses confirm only their own.
        on = armed or torque.energising or torque.unconfirmed
        rank = context.procedures.rank
        held = on or rank is Priority.ARM
        if held or (rank is not None and rank >= Priority.DISARM):  # torque off is still due there
            torque.lose_bus(context.robot.joints.on_bus(bus))
        if held:
            context.condition.latch(finding)
            context.condition.change(RobotEvent.FAULT)
        if held and context.hardware.writers:
            context.executor.stop("aborted", (finding,))
            self._others(armed)
        elif not any(port.reader for port in context.hardware.ports):
            context.procedures.abandon()  # no bus is left to write to
            context.torque.lose_every_bus()
            if context.condition.mode is Mode.LIVE:
                context.executor.stop("aborted", (finding,))
                context.executor.idle()
            context.condition.change_if(RobotEvent.PORT_LOST)

    def _others(self, armed: bool) -> None:
        """Handle the joints on the remaining buses after a bus was lost. `armed`: before the loss.

        On a supported robot (fixed or gantry) they hold until an operator disarms (fault matrix rows 1 and
        2). Otherwise they are lowered, or damped, and torque goes off; the same where a procedure runs or the
        robot is not armed completely.
        """
        context = self._context
        if context.torque.inhibited:
            return  # torque stays, and nothing is written
        if not context.robot.carried or not armed or context.procedures.rank is not None:
            context.procedures.own(Priority.FAULT, self._release.fault)
        elif not context.torque.armed:  # a bus that was lost before is back, but takes no goals of itself
            context.executor.idle()


def _late(port: BusPort) -> str:
    """Return what is known of replies that come too late; empty: none do."""
    late = port.late_reply
    return "" if late is None else LATE.format(*(delay * 1e3 for delay in late))


def _hint(port: BusPort) -> str:
    """Return the likely cause of a device that does not answer although bytes arrive."""
    if late := _late(port):
        return f" in time: {late}"
    return f"; but bytes arrive that are no valid reply: {DOUBLE}" if port.strays else ""


def _differ(findings: Sequence[Finding], before: Sequence[Finding], *, late: bool) -> bool:
    """Return whether findings are worth another report; late replies hit other devices each time."""
    if late:
        return {each.code for each in findings} != {each.code for each in before}
    return tuple(findings) != tuple(before)
