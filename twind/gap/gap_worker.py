"""Gap worker: `python -m twind.gap.gap_worker --binding FD --period S`, started by the front process.

Standard input is a SOCK_SEQPACKET socket: samples in, one JSON report a second out. It runs at low priority,
so that no tick waits for it, and ends at end-of-file. Out of memory, the kernel ends it before the loop.
"""

import argparse
import os
import socket
import sys
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np

from twind.gap.gap_figures import total_gap
from twind.gap.gap_replay import GapReplay
from twind.gap.gap_trend import GapTrend
from twind.gap.sliding_gap import SlidingGap
from twind.sealed_memfd import unseal
from twind.twin.binding_transfer import unpacked
from twind_drivers.clock import MonotonicClock

NICE = 10
OOM_SCORE = 500  # added to its share of the memory, in thousandths; the daemon's unit has -500
PAUSE = 0.1  # s between two looks at the socket: a wake-up per tick would cost more than the physics
LARGEST = 1 << 16  # bytes of a sample


def main() -> int:
    """Report until the front process is gone."""
    parser = argparse.ArgumentParser(prog="twind.gap", description="Started by twind; not for people.")
    parser.add_argument("--binding", type=int, required=True, help="sealed memfd")
    parser.add_argument("--period", type=float, required=True, help="s, of the loop")
    arguments = parser.parse_args()
    os.nice(NICE)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(OOM_SCORE))
    binding = unpacked(unseal(arguments.binding))
    os.close(arguments.binding)
    window = SlidingGap(GapReplay(binding, arguments.period), binding.robot.names, arguments.period)
    trend = GapTrend(binding.robot.identified)
    clock = MonotonicClock()
    with socket.socket(fileno=sys.stdin.fileno()) as sock:
        sock.setblocking(False)
        while True:
            clock.sleep_until(clock.now() + PAUSE)
            try:
                while data := sock.recv(LARGEST):
                    if window.add(np.frombuffer(data)):
                        sock.send(report(window, trend))
                return 0
            except BlockingIOError:
                continue
            except ConnectionError:
                return 0


def report(window: SlidingGap, trend: GapTrend) -> bytes:
    """Return the report of the present window, as JSON."""
    gaps = window.gaps()
    total = {quantity: total_gap(gaps, quantity) for quantity in ("position", "velocity", "effort")}
    shown = {"joints": gaps, "total": total}
    return msgspec.json.encode({"gap": shown, "grown": trend.update(gaps)})


if __name__ == "__main__":
    sys.exit(main())
