"""Power process: `python -m twind.power PAGE PIPE RELAY BUTTON`, started by the loop.

PAGE and PIPE are descriptors: the shared page, and a pipe whose end is the end of the loop. RELAY is
`KIND,LINE,ACTIVE_LOW,TIMEOUT,PORT`, BUTTON is `KIND,LINE,KEY,PORT`; `-`: there is none.
"""

import ctypes
import os
import select
import signal
import sys
from contextlib import suppress
from types import FrameType

from twind.power.dead_man import DeadMan
from twind.power.power_page import PowerPage
from twind.power.power_states import ButtonState, RelayState
from twind.power.relay_switch import RelaySwitch
from twind.power.stop_button import StopButton
from twind_drivers.clock import MonotonicClock

PRIORITY = 50  # SCHED_FIFO: above the loop, so that a loop in an endless computation cannot hold it up
ROUND = 10  # ms between two looks at the page
_MCL_CURRENT_AND_FUTURE = 3  # <sys/mman.h>


class PowerProcess:
    """Relay and button of one loop."""

    def __init__(self, page: PowerPage, pipe: int, relay: str, button: str) -> None:
        """Parse the descriptions of the command line; no device is opened."""
        self.ended = False
        self._page = page
        self._poll = select.poll()
        self._poll.register(pipe, 0)  # reports only a hang-up
        self._clock = MonotonicClock()
        self._relay: RelaySwitch | None = None
        self._dead_man = DeadMan(0.0)
        self._button: StopButton | None = None
        if relay != "-":
            kind, line, active_low, timeout, port = relay.split(",", 4)
            self._relay = RelaySwitch(kind, port, int(line), active_low == "1")
            self._dead_man = DeadMan(float(timeout))
        if button != "-":
            kind, line, key, port = button.split(",", 3)
            self._button = StopButton(kind, port, int(line), int(key))

    def run(self) -> None:
        """Serve until the loop ends. The relay is open afterwards, whatever happened."""
        try:
            while not self.ended and not self._poll.poll(ROUND):
                now = self._clock.now()
                relay = self._serve_relay(now)
                button = ButtonState.UNKNOWN if self._button is None else self._button.read(now)
                troubles = (part.trouble for part in (self._relay, self._button) if part is not None)
                self._page.report(relay, button, "; ".join(filter(None, troubles)))
        finally:
            if self._relay is not None:
                self._relay.drive(False, self._clock.now())
                self._relay.release()

    def _serve_relay(self, now: float) -> RelayState:
        if self._relay is None:
            return RelayState.UNKNOWN
        closed = self._dead_man.is_closed(self._page.loop_beat, self._page.wanted, now)
        state = self._relay.drive(closed, now)
        return RelayState.TRIPPED if self._dead_man.tripped and state is RelayState.OPEN else state


def main() -> None:
    """Run the process. It takes real time where that is permitted."""
    page, pipe, relay, button = sys.argv[1:]
    process = PowerProcess(PowerPage(int(page)), int(pipe), relay, button)

    def end(number: int, frame: FrameType | None) -> None:
        process.ended = True

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, end)
    ctypes.CDLL(None).mlockall(_MCL_CURRENT_AND_FUTURE)
    with suppress(OSError):  # the loop, which asks for the same, reports a denial
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    process.run()


if __name__ == "__main__":
    main()
