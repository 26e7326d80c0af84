"""Messages of the loop to its front: the state every tick, the rest ten times a second."""

from __future__ import annotations

from math import isfinite, nan
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twind import link
from twind.loop.bus.bus_port import PortState
from twind.loop.tick.loop_figures import buckets
from twind.robot.finding import Finding
from twind.robot.joint_state import Imu
from twind.robot.modes import Mode
from twind.telemetry.rolling_stats import RollingStats

if TYPE_CHECKING:
    from twind.loop.tick.control_loop import Loop

ALERT = 0x80  # of a status' error byte: read the hardware error
OVERVIEW = 0.1  # s between two overviews
WHOLE = 0.9  # s between two with histograms: every tenth, however urgent the others are
FRESH = 5.0  # s: the last value of a hop counts as present for so long


class StatePublisher:
    """Builds and sends the messages of a tick. `urgent`: a change that cannot wait for 10 Hz."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self.urgent = True
        self._next = self._whole = 0.0  # s, when it is time for an overview, and for one with histograms
        self._unknown = np.full(len(loop.joints), np.nan).tobytes()

    def publish(self, now: float) -> None:
        """Send the state first, then the replies that refer to it."""
        loop = self._loop
        loop.link.supervise_front(now)
        if self.urgent or now >= self._next:
            if self.urgent or now >= self._whole:
                loop.parts.notifier.status(self.status(), now)
            self.urgent = False
            self._next = now + OVERVIEW
            loop.link.state(self.overview(now))
        loop.link.state(self.tick(now))
        loop.link.flush()

    def tick(self, now: float) -> link.Tick:
        """Return the state after this tick."""
        loop = self._loop
        state = loop.simulated if loop.mode is Mode.SIM else loop.measured
        imu = state.imu
        reference = loop.executor.reference
        raw = loop.hardware.readings.raw
        read = loop.measured.time
        return link.Tick(
            time=now,
            sequence=loop.figures.ticks,
            mode=loop.mode.value,
            state=loop.state.value,
            motion=loop.executor.motion.value,
            armed=loop.torque.armed,
            inherited=loop.inherited,
            position=state.position.tobytes(),
            velocity=state.velocity.tobytes(),
            effort=state.effort.tobytes(),
            age=state.age.tobytes(),
            heard=state.heard.tobytes(),
            goal=self._unknown if reference is None else np.ascontiguousarray(reference.position).tobytes(),
            simulated=loop.simulated.position.tobytes(),
            read=read,
            raw=raw.ticks.tobytes(),
            raw_effort=raw.effort.tobytes(),
            raw_age=raw.age(read).tobytes(),
            dropped=loop.link.dropped,
            skew=loop.hardware.skew if loop.mode is not Mode.SIM else nan,
            imu=b"" if imu is None else _packed(imu),
            imu_age=nan if imu is None else max(0.0, state.time - imu.time),
        )

    def status(self) -> str:
        """Return one line for the service manager: the state, and the first problem."""
        loop = self._loop
        fresh = int(loop.measured.heard.sum())
        rate = 1.0 / loop.period
        summary = (
            f"{loop.mode.value}, {loop.state.value}, {fresh} of {len(loop.joints)} joints fresh, {rate:g} Hz"
        )
        return "; ".join(part for part in (summary, self._wrong(), loop.reloads.result) if part)

    def _wrong(self) -> str:
        """Return the first problem as text; "": none.

        Problems: no front, a latched or arming-blocking finding, a bus problem, torque found on.
        """
        loop = self._loop
        if loop.link.no_front:
            return f"no client can be served: {loop.link.no_front}"
        if loop.unreachable is not None:
            return f"{loop.unreachable.code}: {loop.unreachable.message}"
        for finding in (*loop.latches.values(), *loop.identity.troubles):
            joint = "" if finding.joint is None else f" {loop.joints.names[finding.joint]}"
            return f"{finding.code}{joint}: {finding.message}"
        for port in loop.hardware.ports:
            if port.trouble:
                return port.trouble
        return "torque was found on" if loop.inherited else ""

    def overview(self, now: float) -> link.Overview:
        """Build the slowly changing part of the state, such as latencies, buses, lease and faults."""
        loop = self._loop
        slow = loop.hardware.slow
        latency = loop.health.total
        whole = now >= self._whole
        self._whole = now + WHOLE if whole else self._whole
        return link.Overview(
            time=now,
            latency_ms=_ms(latency.now) if loop.mode is not Mode.SIM else None,
            latency_avg_ms=_ms(latency.mean),
            latency_max_ms=_ms(latency.max),
            violations=latency.violations,
            skew_ms=_ms(loop.hardware.skew) if loop.mode is not Mode.SIM else None,
            skew_max_ms=_ms(loop.hardware.worst_skew),
            hw_connected=loop.mode is not Mode.SIM and loop.hardware.connected,
            sim_connected=True,
            lease=self.lease(now),
            lease_client=loop.lease.holder_client(now),
            faults=self._faulty(),
            latched=[code.value for code in loop.latches],
            buses=[self._bus(place) for place in range(len(loop.hardware.ports))],
            loop=loop.figures.info(whole=whole),
            latencies=[_latency(hop, window, now, whole) for hop, window in self._windows()],
            temperature=slow.temperature.tobytes(),
            voltage=slow.voltage.tobytes(),
            torque=loop.torque_known.tobytes(),
            fault_bits=self._faults().tobytes(),
            verified=b"" if loop.mode is Mode.SIM else loop.identity.verified.joints.tobytes(),
        )

    def _faulty(self) -> list[Finding]:
        """Return the latched findings and all other reasons that prevent arming now, each once."""
        loop = self._loop
        lost = () if loop.unreachable is None else (loop.unreachable,)
        found = (*lost, *loop.latches.values(), *loop.identity.troubles, *loop.parts.guard.bars)
        return list({(each.code, each.joint, each.message): each for each in found}.values())

    def _faults(self) -> NDArray[np.int16]:
        """Return hardware error bits (n,), -1 unknown; bit 8: the last reply carried the alert flag."""
        hardware = self._loop.hardware
        alert = (hardware.readings.alerts & ALERT) != 0
        faults: NDArray[np.int16] = np.where(
            alert, np.maximum(hardware.slow.fault, 0) | 0x100, hardware.slow.fault
        )
        return faults.astype(np.int16)

    def _windows(self) -> list[tuple[str, RollingStats]]:
        health = self._loop.health
        return [("total", health.total), *health.hops.items()]

    def lease(self, now: float) -> link.LeaseInfo | None:
        """Return the holder of the lease at `now` (s); None: the lease is free."""
        held = self._loop.lease.info(now)
        return None if held is None else link.LeaseInfo(held.holder, held.uid, held.expires_in)

    def _bus(self, place: int) -> link.BusInfo:
        port = self._loop.hardware.ports[place]
        window = self._loop.health.buses[place]
        return link.BusInfo(
            name=port.name,
            port=port.where or "",
            connected=port.link is PortState.CONNECTED,
            latency_ms=_ms(window.now),
            latency_p99_ms=_ms(window.p99),
            utilisation=min(1.0, port.counts.busy / self._loop.period) if port.reader else 0.0,
            exchanges=port.counts.exchanges,
            errors=port.counts.errors,
            warning=port.warning or None,
            late_reply_ms=None if (late := port.late_reply) is None else late[1] * 1e3,
        )


def _packed(imu: Imu) -> bytes:
    return np.concatenate((imu.gyro, imu.acceleration, imu.quaternion)).tobytes()


def _latency(hop: str, window: RollingStats, now: float, whole: bool) -> link.LatencyInfo:
    return link.LatencyInfo(
        hop=hop,
        now_ms=_ms(window.now) if now - window.at <= FRESH else None,
        mean_ms=_ms(window.mean),
        std_ms=_ms(window.std),
        min_ms=_ms(window.min),
        max_ms=_ms(window.max),
        p50_ms=_ms(window.p50),
        p99_ms=_ms(window.p99),
        violations=window.violations,
        histogram=buckets(window) if whole else None,
        histogram_sum_ms=window.sum * 1e3 if whole else None,
    )


def _ms(seconds: float) -> float | None:
    return seconds * 1e3 if isfinite(seconds) else None
