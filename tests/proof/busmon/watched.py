"""A monitor on every bus of a daemon that runs in this process: what `tests/support/daemon_rig.py` gives is
enough.

Takes any rig by its parts (robot, virtual, loop, clock), so it imports nothing of what it watches.
"""

from pathlib import Path
from typing import Any

from tests.proof.busmon.bus import AnyMonitor, limits_of, monitor_of
from tests.proof.busmon.can.monitor import CanMonitor
from tests.proof.busmon.can.text import text


class Watched:
    """The buses of a rig, tapped at the wire. `rig` may take up a new daemon: `born` says so."""

    def __init__(self, rig: Any, calibration_file: Path, *, rate_hz: float | None = None) -> None:
        """`calibration_file`: the one that fits these servos, as `twind-virtual --calibration` writes it."""
        self.rig = rig
        rate = rate_hz or rig.robot.rate_hz
        self.monitors = {
            name: monitor_of(limits_of(rig.robot.path, calibration_file, name, rate_hz=rate))
            for name in rig.virtual
        }
        self._said: dict[str, Any] = {}
        for name, bus in rig.virtual.items():
            self._tap(self.monitors[name], bus)

    def _tap(self, monitor: AnyMonitor, bus: Any) -> None:
        if isinstance(monitor, CanMonitor):
            self._tap_frames(monitor, bus)
            return
        receive = bus.receive
        take = bus.take

        def received(data: bytes, now: float) -> None:
            if data:
                self.listen(now)
                monitor.sent(bytes(data), now)
            receive(data, now)

        def taken(now: float) -> bytes:
            data = take(now)
            if data:
                monitor.answered(bytes(data), now)
            return bytes(data)

        bus.receive = received
        bus.take = taken

    def _tap_frames(self, monitor: CanMonitor, bus: Any) -> None:
        """A CAN bus in this process takes and gives frames: told as the text that an adapter would have."""
        hear = bus.take_host_frames
        say = bus.give_host_frames

        def receive(frames: Any, now: float) -> int:
            self.listen(now)
            monitor.sent(text(frames.tobytes()), now)
            return int(hear(frames, now))

        def give(now: float) -> Any:
            frames = say(now)
            if frames.size:
                monitor.answered(text(frames.tobytes()), now)
            return frames

        bus.take_host_frames = receive
        bus.give_host_frames = give

    def listen(self, now: float) -> None:
        """Report each change of the daemon's state to every monitor."""
        loop = self.rig.loop
        self._tell("mode", now, mode=str(loop.condition.mode.value))
        self._tell("state", now, state=str(loop.condition.state.value))
        level = loop.torque.stop_level if loop.condition.state.value == "estop" else None
        if self._said.get("estop") != level:
            self._said["estop"] = level
            if level is not None:
                self.take_report("estop", now, level=level)
        soft = loop.torque.soft_since
        if soft != self._said.get("damp"):
            self._said["damp"] = soft
            if soft is not None:
                self.take_report("damp", now)
        for port in loop.hardware.ports:
            if port.name not in self.monitors:
                continue
            is_open = port.reader is not None
            if self._said.get(("port", port.name)) not in (None, is_open):
                self.monitors[port.name].take_report("port", now, open=is_open)
            self._said["port", port.name] = is_open

    def _tell(self, what: str, now: float, **facts: Any) -> None:
        if self._said.get(what) != facts:
            self._said[what] = facts
            self.take_report(what, now, **facts)

    def take_report(self, what: str, now: float, **facts: Any) -> None:
        """Something that all monitors must know."""
        for monitor in self.monitors.values():
            monitor.take_report(what, now, **facts)

    def look(self) -> None:
        """Between ticks: rules about silence."""
        now = self.rig.clock.now()
        self.listen(now)
        for monitor in self.monitors.values():
            monitor.look(now)

    def verdict(self, report: str = "") -> None:
        """Raises AssertionError with what was broken and the last packets before it."""
        for name, monitor in self.monitors.items():
            if monitor.violations:
                lines = [report, *map(str, monitor.violations[:10]), f"last packets on {name}:"]
                raise AssertionError("\n".join([*lines, *(str(seen)[:400] for seen in monitor.last)]))
