"""A user's program that reads every state of the robot until SIGTERM, and connects again where it must."""

import signal
import sys
from contextlib import suppress

from twind import Robot
from twind.client import ClientError


def main() -> None:
    """The folder of the sockets is the argument."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    while True:
        with suppress(ClientError), Robot(sys.argv[1], read_only=True) as robot:
            for _ in robot.states(patience=5.0):
                pass


if __name__ == "__main__":
    main()
