"""Power process as a child of the loop (`twind/power/`), supervised by its heartbeat. Loop's process.

The child outlives a loop that is killed: its end of a pipe then hangs up, and it opens the relay.
"""

import contextlib
import os
import select
import signal
from math import inf

from twind.config.power_config import LEAST_TICKS, ButtonSpec, RelaySpec
from twind.exceptions import InvalidInput
from twind.loop.ipc.child_process import FIRST, spawn
from twind.power.power_page import SIZE, PowerPage
from twind.power.power_states import ButtonState, RelayState

SILENT = 0.5  # s without a heartbeat of the child: it is killed and started anew
GRACE = 5.0  # s that a new child may take to its first heartbeat
AGAIN = 0.5  # s between two starts
ENDING = 1.0  # s that the child has to open the relay and end


class PowerChild:
    """Power process of one loop. Its states are UNKNOWN while it does not report."""

    def __init__(self, relay: RelaySpec | None, button: ButtonSpec | None, rate_hz: float) -> None:
        """No process yet. Raises InvalidInput: the relay's timeout is too short for this rate."""
        if relay is not None and relay.timeout * rate_hz < LEAST_TICKS:
            least = LEAST_TICKS * 1e3 / rate_hz
            reason = f"{relay.timeout * 1e3:g} ms is less than {LEAST_TICKS} ticks at {rate_hz:g} Hz"
            raise InvalidInput(f"{reason}: at least {least:g}", where="power.relay.timeout_ms")
        self.relay_spec = relay
        self.button_spec = button
        self.pid: int | None = None
        self._cpus = os.sched_getaffinity(0)  # from before the loop was pinned
        self._memory = os.memfd_create("twind-power", os.MFD_CLOEXEC)
        os.ftruncate(self._memory, SIZE)
        self._page = PowerPage(self._memory)
        self._pipe = -1  # the end that only the loop holds
        self._beat = 0
        self._alive_until = -inf
        self._start_at = -inf
        self._reported = False

    @property
    def relay(self) -> RelayState:
        """State of the relay."""
        return self._page.relay if self._reported else RelayState.UNKNOWN

    @property
    def button(self) -> ButtonState:
        """State of the button."""
        return self._page.button if self._reported else ButtonState.UNKNOWN

    @property
    def trouble(self) -> str:
        """Text for people about a device that does not work; empty: none."""
        return self._page.trouble if self._reported else ""

    def beat(self, wanted: bool) -> None:
        """Note a completed tick, and whether the relay is to be closed."""
        self._page.beat(wanted)

    def supervise(self, now: float) -> None:
        """Start the child when it is due, and end one that hangs."""
        if (beat := self._page.process_beat) != self._beat:
            self._beat = beat
            self._reported = True
            self._alive_until = now + SILENT
        elif now > self._alive_until:
            self._reported = False
            self._replace(now)

    def _replace(self, now: float) -> None:
        if self.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            with contextlib.suppress(ChildProcessError):
                ended, _ = os.waitpid(self.pid, os.WNOHANG)
                if not ended:
                    return
            self.pid = None
            self._close_pipe()
            self._start_at = now + AGAIN
        elif now >= self._start_at:
            self._start_at = now + AGAIN
            with contextlib.suppress(OSError):  # tried again
                self._start(now)

    def _start(self, now: float) -> None:
        theirs, self._pipe = os.pipe2(os.O_CLOEXEC)
        try:
            self._page.clear()
            self._beat = self._page.process_beat
            arguments = ["-m", "twind.power", str(FIRST), str(FIRST + 1), *self._described()]
            self.pid = spawn(arguments, [self._memory, theirs], self._cpus)
            self._alive_until = now + GRACE
        except OSError:
            self._close_pipe()
            raise
        finally:
            os.close(theirs)

    def _described(self) -> tuple[str, str]:
        """Return relay and button as the command line of the child has them."""
        relay = self.relay_spec
        button = self.button_spec
        return (
            "-"
            if relay is None
            else f"{relay.kind},{relay.line},{relay.active_low:d},{relay.timeout},{relay.port}",
            "-" if button is None else f"{button.kind},{button.line},{button.key},{button.port}",
        )

    def _close_pipe(self) -> None:
        if self._pipe >= 0:
            os.close(self._pipe)
            self._pipe = -1

    def close(self) -> None:
        """End the child; the relay is open then."""
        self._close_pipe()
        if self.pid is not None:
            pidfd = os.pidfd_open(self.pid)
            gone, _, _ = select.select([pidfd], [], [], ENDING)
            os.close(pidfd)
            if not gone:
                os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
            self.pid = None
        self._page.close()
        os.close(self._memory)
