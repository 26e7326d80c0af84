"""Messages of the loop to its front: the state every tick, the rest ten times a second."""

from __future__ import annotations

from math import isfinite, nan

import numpy as np
from numpy.typing import NDArray

from twind import link
from twind.loop.bus.bus_port import PortState
from twind.loop.procedures.identification import IdentificationState
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.reload_coordinator import ReloadCoordinator
from twind.loop.procedures.supply_control import SupplyControl
from twind.loop.procedures.torque_readback import torque_inherited, torque_known, torque_reported
from twind.loop.tick.loop_figures import LoopFigures, buckets
from twind.loop.tick.loop_parts import LoopParts
from twind.robot.external_torque import ExternalTorque
from twind.robot.finding import Finding
from twind.robot.joint_state import Imu
from twind.robot.modes import Mode
from twind.telemetry.rolling_stats import RollingStats

ALERT = 0x80  # of a status' error byte: read the hardware error
OVERVIEW = 0.1  # s between two overviews
STATUS = 0.3  # s between two status lines, of which the service manager gets at most one a second
WHOLE = 0.9  # s between two with histograms: every tenth, however urgent the others are
FRESH = 5.0  # s: the last value of a hop counts as present for so long


class StatePublisher:
    """Builds and sends the messages of a tick."""

    def __init__(
        self,
        context: ProcedureContext,
        parts: LoopParts,
        identity: IdentificationState,
        reloads: ReloadCoordinator,
        figures: LoopFigures,
        supply: SupplyControl,
    ) -> None:
        self._context = context
        self._parts = parts
        self._identity = identity
        self._reloads = reloads
        self._figures = figures
        self._supply = supply
        self._next = self._whole = 0.0  # s, when it is time for an overview, and for one with histograms
        self._status_at = 0.0  # s, when the line for the service manager is made again
        self._unknown = np.full(len(context.robot.joints), np.nan).tobytes()
        self._no_faults = np.full(len(context.robot.joints), -1, np.int16).tobytes()

    def publish(self, now: float) -> None:
        """Send the state first, then the replies that refer to it."""
        context = self._context
        self._parts.link.supervise_front(now)
        if context.reports.urgent or now >= self._next:
            if context.reports.urgent or now >= self._status_at:
                self._status_at = now + STATUS
                self._parts.notifier.status(self.status(), now)
            context.reports.urgent = False
            self._next = now + OVERVIEW
            self._parts.link.state(self.overview(now))
        self._parts.link.state(self.tick(now))
        self._parts.link.flush()

    def tick(self, now: float) -> link.Tick:
        """Return the state after this tick."""
        context = self._context
        state = context.robot.simulated if context.condition.mode is Mode.SIM else context.robot.measured
        imu = state.imu
        reference = context.executor.reference
        raw = context.hardware.readings.raw
        read = context.robot.measured.time
        observer = context.robot.observer
        external = None if observer is None else observer.external
        rules = self._parts.guard.contact
        return link.Tick(
            time=now,
            sequence=self._figures.ticks,
            mode=context.condition.mode.value,
            state=context.condition.state.value,
            motion=context.executor.motion.value,
            armed=context.torque.armed,
            inherited=torque_inherited(context),
            position=state.position.tobytes(),
            velocity=state.velocity.tobytes(),
            effort=state.effort.tobytes(),
            age=state.age.tobytes(),
            heard=state.heard.tobytes(),
            goal=self._unknown if reference is None else np.ascontiguousarray(reference.position).tobytes(),
            simulated=context.robot.simulated.position.tobytes(),
            external=b"" if external is None or rules is None else _force(external, rules.touched),
            read=read,
            raw=raw.ticks.tobytes(),
            raw_effort=raw.effort.tobytes(),
            raw_age=raw.age(read).tobytes(),
            dropped=self._parts.link.dropped,
            skew=context.hardware.last_exchange.skew if context.condition.mode is not Mode.SIM else nan,
            imu=b"" if imu is None else _packed(imu),
            imu_age=nan if imu is None else max(0.0, state.time - imu.time),
        )

    def status(self) -> str:
        """Return one line for the service manager: the state, and the first problem."""
        context = self._context
        fresh = int(context.robot.measured.heard.sum())
        count = len(context.robot.joints)
        rate = 1.0 / context.robot.period
        condition = context.condition
        summary = (
            f"{condition.mode.value}, {condition.state.value}, {fresh} of {count} joints fresh, {rate:g} Hz"
        )
        return "; ".join(part for part in (summary, self._wrong(), self._reloads.result) if part)

    def _wrong(self) -> str:
        """Return the first problem as text; "": none.

        Problems: no front, a latched or arming-blocking finding, a bus problem, torque found on.
        """
        context = self._context
        if self._parts.link.no_front:
            return f"no client can be served: {self._parts.link.no_front}"
        if context.condition.unreachable is not None:
            return f"{context.condition.unreachable.code}: {context.condition.unreachable.message}"
        for finding in (
            *context.condition.latches.values(),
            *self._identity.troubles,
            *self._supply.findings,
        ):
            joint = "" if finding.joint is None else f" {context.robot.joints.names[finding.joint]}"
            return f"{finding.code}{joint}: {finding.message}"
        for port in context.hardware.ports:
            if port.trouble:
                return port.trouble
        return "torque was found on" if torque_inherited(context) else ""

    def overview(self, now: float) -> link.Overview:
        """Build the slowly changing part of the state, such as latencies, buses, lease and faults."""
        context = self._context
        slow = context.hardware.slow
        sim = context.condition.mode is Mode.SIM  # no value of a robot that was read before
        latency = self._parts.health.total
        whole = now >= self._whole
        self._whole = now + WHOLE if whole else self._whole
        return link.Overview(
            time=now,
            latency_ms=None if sim else _ms(latency.now),
            latency_avg_ms=_ms(latency.mean),
            latency_max_ms=_ms(latency.max),
            violations=latency.violations,
            skew_ms=None if sim else _ms(context.hardware.last_exchange.skew),
            skew_max_ms=_ms(context.hardware.last_exchange.worst_skew),
            hw_connected=not sim and context.hardware.connected,
            sim_connected=True,
            lease=self.lease(now),
            lease_client=self._parts.lease.holder_client(now),
            faults=self._faulty(),
            latched=[code.value for code in context.condition.latches],
            buses=[self._bus(place) for place in range(len(context.hardware.ports))],
            loop=self._figures.info(whole=whole),
            latencies=[_latency(hop, window, now, whole) for hop, window in self._windows()],
            temperature=self._unknown if sim else slow.temperature.tobytes(),
            voltage=self._unknown if sim else slow.voltage.tobytes(),
            torque=torque_known(context).tobytes(),
            torque_on=torque_reported(context),
            fault_bits=self._no_faults if sim else self._faults().tobytes(),
            supply_relay=self._supply.relay_text,
            stop_button=self._supply.button_text,
            fall=None if self._parts.guard.falls is None else self._parts.guard.falls.state.value,
            verified=b"" if sim else self._identity.verified.joints.tobytes(),
        )

    def _faulty(self) -> list[Finding]:
        """Return the latched findings and all other reasons that prevent arming now, each once."""
        context = self._context
        lost = () if context.condition.unreachable is None else (context.condition.unreachable,)
        found = (
            *lost,
            *context.condition.latches.values(),
            *self._identity.troubles,
            *self._supply.findings,
            *self._parts.guard.bars,
        )
        return list({(each.code, each.joint, each.message): each for each in found}.values())

    def _faults(self) -> NDArray[np.int16]:
        """Return hardware error bits (n,), -1 unknown; bit 8: the last reply carried the alert flag."""
        hardware = self._context.hardware
        alert = (hardware.readings.alerts & ALERT) != 0
        faults: NDArray[np.int16] = np.where(
            alert, np.maximum(hardware.slow.fault, 0) | 0x100, hardware.slow.fault
        )
        return faults.astype(np.int16)

    def _windows(self) -> list[tuple[str, RollingStats]]:
        health = self._parts.health
        return [("total", health.total), *health.hops.items()]

    def lease(self, now: float) -> link.LeaseInfo | None:
        """Return the holder of the lease at `now` (s); None: the lease is free."""
        held = self._parts.lease.info(now)
        return None if held is None else link.LeaseInfo(held.holder, held.uid, held.expires_in)

    def _bus(self, place: int) -> link.BusInfo:
        port = self._context.hardware.ports[place]
        window = self._parts.health.buses[place]
        return link.BusInfo(
            name=port.name,
            port=port.where or "",
            connected=port.link is PortState.CONNECTED,
            latency_ms=_ms(window.now),
            latency_p99_ms=_ms(window.p99),
            utilisation=min(1.0, port.counts.busy / self._context.robot.period) if port.reader else 0.0,
            exchanges=port.counts.exchanges,
            errors=port.counts.errors,
            warning=port.warning or None,
            late_reply_ms=None if (late := port.late_reply) is None else late[1] * 1e3,
        )


def _force(external: ExternalTorque, touched: NDArray[np.bool_]) -> bytes:
    """Return torque, deviation and contact as `Tick.external`."""
    return np.concatenate((external.torque, external.deviation, touched)).tobytes()


def _packed(imu: Imu) -> bytes:
    return np.concatenate((imu.gyro, imu.acceleration, imu.quaternion)).tobytes()


def _latency(hop: str, window: RollingStats, now: float, whole: bool) -> link.LatencyInfo:
    figures = window.figures()
    return link.LatencyInfo(
        hop=hop,
        now_ms=_ms(window.now) if now - window.at <= FRESH else None,
        mean_ms=_ms(figures.mean),
        std_ms=_ms(figures.std),
        min_ms=_ms(figures.min),
        max_ms=_ms(figures.max),
        p50_ms=_ms(figures.p50),
        p99_ms=_ms(figures.p99),
        violations=window.violations,
        histogram=buckets(window) if whole else None,
        histogram_sum_ms=window.sum * 1e3 if whole else None,
    )


def _ms(seconds: float) -> float | None:
    return seconds * 1e3 if isfinite(seconds) else None
