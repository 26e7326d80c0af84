"""Actuators for the CAN figures: `python -m bench.can_responder`, a process of its own behind a pty.

It is a serial adapter that speaks slcan, with actuators behind it that answer every standard frame at once,
by the frame's id + 100 (hex) and a made-up feedback; so only the host's CPU is left to measure. Never sleeps:
a host that must wake us would pay for it.
"""

import os
import pty
import sys
import termios
import time
import tty

ROOM = 1 << 16
IDLE = 60.0  # s without a byte: whoever started us is gone
OFFSET = 0x100  # from a command's id to its answer's
ENABLED = 0x10  # Damiao: status 1 in the high nibble of the first byte, the id's low nibble in the low one
FEEDBACK = "8A3C7F07FF2628"  # position, velocity, torque, 38 and 40 degrees


def answer(line: bytes) -> bytes:
    """The reply to one line: empty unless the line is a standard frame of 8 bytes."""
    if len(line) != 21 or not line.startswith(b"t"):
        return b""
    id = int(line[1:4], 16)
    return f"t{id + OFFSET:03X}8{ENABLED | id & 0xF:02X}{FEEDBACK}\r".encode()


def main() -> int:
    """Serve until ended, or until nobody has said anything for a minute."""
    master, slave = pty.openpty()
    tty.setraw(slave, termios.TCSANOW)
    print(os.ttyname(slave), flush=True)
    os.set_blocking(master, False)
    known: dict[bytes, bytes] = {}
    rest = b""
    heard = time.perf_counter()
    while time.perf_counter() - heard < IDLE:
        try:
            data = os.read(master, ROOM)
        except BlockingIOError:
            continue
        except (OSError, KeyboardInterrupt):
            return 0
        heard = time.perf_counter()
        *lines, rest = (rest + data).split(b"\r")
        said = b""
        for line in lines:
            key = line[:5]
            if key not in known:
                known[key] = answer(line)
            said += known[key]
        if said:
            os.write(master, said)
    return 0


if __name__ == "__main__":
    sys.exit(main())
