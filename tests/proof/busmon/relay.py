"""The monitor as a process: between the servos' port and the daemon's, passing every byte on and judging it.

Bytes go on first and are judged then: it is a witness, no gate. Ends with 1 at the first violation.
"""

import json
import os
import select
import signal
import sys
from collections import deque
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any

from tests.proof.busmon.bus import AnyLimits, monitor_of, port_baud
from tests.proof.busmon.monitor import Monitor
from tests.proof.busmon.observe import Observer
from tests.proof.busmon.ports import CHUNK, DaemonEnd, Holders, ServoEnd, baud_of, set_baud, write_all

LOOK = 0.005  # s between two looks, traffic or not
BLIND = 0.02  # s: a longer gap between two rounds was ours, not the daemon's
AGAIN = 0.05  # s between tries to open a port or a socket
KEPT = 20_000  # durations of passing on


class Relay:
    """One bus between two ports."""

    def __init__(
        self,
        servos: Path,
        link: Path,
        limits: AnyLimits,
        *,
        observe: Path | None,
        hearsay: float,
        early: float = 0.0,
    ) -> None:
        """`early`: see `Monitor.early_share`."""
        self.monitor = monitor_of(limits, hearsay=hearsay)
        if isinstance(self.monitor, Monitor):
            self.monitor.early_share = early
        self._servos = ServoEnd(servos)
        self._daemon = DaemonEnd(link)
        self._observer = Observer(observe) if observe else None
        self._holders = Holders()
        self._process = -1  # pidfd of the daemon
        self._orders = b""
        self._baud = port_baud(limits)
        self._try_at = 0.0
        self._was_there = False
        self.ended = False
        self._since = 0.0  # s, the earliest that what is read now can have come
        self._empty = 0.0  # s, when the daemon's port was last known to hold nothing
        self.passed: deque[float] = deque(maxlen=KEPT)  # s from waking up to having passed bytes on
        self.blind = 0  # gaps that were our own

    # ------------------------------------------------------------------------- time

    def run(self) -> int:
        """Until told to end, or the first violation; the exit code."""
        signal.signal(signal.SIGTERM, lambda number, frame: setattr(self, "ended", True))
        self._open(monotonic())
        print(f"relay {self._daemon.path}", flush=True)
        last = monotonic()
        while not self.ended:
            self._since = self._nothing_until()
            ready = self._wait()
            now = monotonic()
            if now - last > LOOK + BLIND:
                self.blind += 1
                self.monitor.take_report("blind", now)
            self._round(ready, now)
            if not ready and (others := self._holders.step(self._daemon.path)):
                self.monitor.take_report("talker", now, processes=others)
            last = now
            if self.monitor.violations:
                self.report()
                return 1
        self.monitor.look(monotonic())
        self.report()
        return 1 if self.monitor.violations else 0

    def _nothing_until(self) -> float:
        """Bytes in the buffer may have come at any time since the port was last found empty: while this
        process judged, or was kept from running."""
        before = monotonic()
        if not self._daemon.present or not select.select([self._daemon.fd], [], [], 0.0)[0]:
            self._empty = before
        return self._empty

    def _wait(self) -> set[int]:
        sources = [self._servos.fd, self._process, sys.stdin.fileno() if not self.ended else -1]
        sources.append(self._daemon.fd if self._daemon.present else -1)
        if self._observer is not None:
            sources.append(self._observer.fileno())
        ready, _, _ = select.select([fd for fd in sources if fd >= 0], [], [], LOOK)
        return set(ready)

    def _round(self, ready: set[int], now: float) -> None:
        if self._servos.fd in ready:
            self._from_servos(now)
        if self._daemon.fd in ready:
            self._from_daemon(now)
        if self._process in ready and self._process >= 0:
            self._died(now)
        self._come_and_go(now)
        if sys.stdin.fileno() in ready:
            self._ordered(now)
        if self._observer is not None and self._observer.fileno() in ready:
            for what, facts in self._observer.words():
                self.monitor.take_report(what, now, **facts)
        self.monitor.look(now)

    # ------------------------------------------------------------------------- bytes

    def _from_servos(self, now: float) -> None:
        try:
            data = os.read(self._servos.fd, CHUNK)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._unplugged(now)
            return
        if self._daemon.present:
            with suppress(OSError):
                write_all(self._daemon.fd, data)
        self.passed.append(monotonic() - now)
        self.monitor.answered(data, now)

    def _from_daemon(self, now: float) -> None:
        self._empty = monotonic()
        data = self._daemon.read()
        if not data:
            return
        if not self._was_there:
            self._arrived(now)
        if (baud := baud_of(self._daemon.fd)) != self._baud and baud > 0 and self._servos.fd >= 0:
            set_baud(self._servos.fd, baud)
            self._baud = baud
        with suppress(OSError):
            write_all(self._servos.fd, data)
        self.passed.append(monotonic() - now)
        self.monitor.sent(data, now, self._since)

    # ------------------------------------------------------------------------- coming and going

    def _open(self, now: float) -> None:
        self._try_at = now + AGAIN
        if self._servos.open(self._baud):
            self._daemon.open()

    def _unplugged(self, now: float) -> None:
        """The hang-up is passed on, and the port comes back when the servos' does."""
        self._servos.close()
        self._daemon.close()
        self._was_there = False
        self.monitor.take_report("port", now, open=False)

    def _come_and_go(self, now: float) -> None:
        if now >= self._try_at:
            self._try_at = now + AGAIN
            if self._servos.fd < 0:
                self._open(now)
            if self._observer is not None and self._observer.fileno() < 0:
                self.monitor.words.deaf = not self._observer.connect()
        there = self._daemon.look()
        if there and not self._was_there:
            self._arrived(now)
        elif not there and self._was_there:
            while data := self._daemon.read():
                self.monitor.sent(data, now, self._since)
            self._was_there = False
            self.monitor.take_report("port", now, open=False)

    def _arrived(self, now: float) -> None:
        """Whoever opens the port begins anew: with nothing read, nothing written, nobody killed."""
        self._was_there = True
        state = self.monitor.words.state
        self.monitor.take_report("born", now)
        if self._observer is not None and self._observer.fileno() >= 0:
            self.monitor.take_report("state", now, state=state)  # the same daemon, back on its port

    def _died(self, now: float) -> None:
        """The process is gone: what it had written before is still read, then nothing may come."""
        os.close(self._process)
        self._process = -1
        if self._was_there:
            while data := self._daemon.read():
                with suppress(OSError):
                    write_all(self._servos.fd, data)
                self.monitor.sent(data, now, self._since)
        self.monitor.take_report("killed", now)

    # ------------------------------------------------------------------------- orders and words

    def _ordered(self, now: float) -> None:
        """Lines of JSON: {"pid": N}, {"level": "cut"} of the next e-stop, {"told": what, ...}; the end of the
        file ends the relay."""
        data = os.read(sys.stdin.fileno(), CHUNK)
        if not data:
            self.ended = True
            return
        *lines, self._orders = (self._orders + data).split(b"\n")
        for line in lines:
            order: dict[str, Any] = json.loads(line)
            if "pid" in order:
                self._process = os.pidfd_open(order["pid"])
            elif "told" not in order and self._observer is not None:
                self._observer.level = order["level"]
            else:
                what = order.pop("told")
                facts = {key: _by_id(value) for key, value in order.items()}
                self.monitor.take_report(what, now, **facts)

    def report(self) -> None:
        """Print counts, and for a violation all that led to it."""
        monitor = self.monitor
        for violation in monitor.violations[:20]:
            print(f"violation {violation}")
        if monitor.violations:
            print(f"last {len(monitor.last)} packets:")
            for seen in monitor.last:
                print(f"  {seen}")
        passed = sorted(self.passed) or [0.0]
        counts = {
            "packets": monitor.sent_packets,
            "goals": monitor.goal_packets,
            "answers": monitor.answers,
            "violations": len(monitor.violations),
            "early": monitor.early if isinstance(monitor, Monitor) else 0,
            "blind": self.blind,
            "passed_p50_us": round(passed[len(passed) // 2] * 1e6, 1),
            "passed_p99_us": round(passed[len(passed) * 99 // 100] * 1e6, 1),
        }
        print(json.dumps(counts), flush=True)


def _by_id(value: Any) -> Any:
    """JSON's keys are text; ids are numbers."""
    return {int(key): each for key, each in value.items()} if isinstance(value, dict) else value
