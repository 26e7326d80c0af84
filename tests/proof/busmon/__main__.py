"""`python -m tests.proof.busmon --servos PORT --link PATH --robot FILE --calibration FILE`: relay and
monitor.

Prints `relay PATH` when the daemon's port is there. Lines of JSON on standard input tell what bytes do not:
{"pid": N} whose death to watch, {"level": "cut"} of the next e-stop, {"told": "state", ...} and the
like; its end ends the relay.
Exit code 0: nothing was wrong; 1: the first violation, printed with the last 200 packets.
"""

import argparse
import gc
import os
import sys
from contextlib import suppress
from pathlib import Path

from tests.proof.busmon.bus import limits_of
from tests.proof.busmon.relay import Relay


def main() -> int:
    """Parse, take a real-time priority where that is allowed, relay."""
    parser = argparse.ArgumentParser(prog="busmon", description=__doc__)
    parser.add_argument("--servos", type=Path, required=True, help="port of the servos")
    parser.add_argument("--link", type=Path, required=True, help="link to the port that the daemon is given")
    parser.add_argument("--robot", type=Path, required=True, help="robot file")
    parser.add_argument("--calibration", type=Path, required=True, help="calibration file")
    parser.add_argument("--bus", default="main", help="bus of the robot file")
    parser.add_argument("--rate", type=float, help="Hz of the loop, where it is not the robot file's")
    parser.add_argument("--observe", type=Path, help="the daemon's observe.sock, for its states")
    parser.add_argument("--hearsay", type=float, default=0.5, help="s that those may come late")
    parser.add_argument("--early", type=float, default=0.0, help="share of packets that may seem early (W9)")
    given = parser.parse_args()
    limits = limits_of(given.robot, given.calibration, given.bus, rate_hz=given.rate)
    with suppress(OSError):  # without the right to it an ordinary process judges as well, with more delay
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(45))
    gc.collect()
    gc.freeze()
    how = {"observe": given.observe, "hearsay": given.hearsay, "early": given.early}
    return Relay(given.servos, given.link, limits, **how).run()


if __name__ == "__main__":
    sys.exit(main())
