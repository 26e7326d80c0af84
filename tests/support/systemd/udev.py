"""Messages of udevd to PID 1 about a device, on a machine without udevd. Standard library only; run inside:

    udev.py add|remove LINK WANTS      LINK: a name below /dev; WANTS: units that it starts, or ""

One libudev datagram in the private net namespace, and the files of udev's data base that go with it. No
kernel event is made and nothing is written to sysfs. The device is a terminal that sysfs knows (PID 1 looks
it up there); what stands behind its name is not opened by anybody.
"""

import os
import socket
import struct
import sys
import time
from pathlib import Path

# libudev-monitor's own message
NETLINK_KOBJECT_UEVENT = 15
GROUP_UDEV = 2
MAGIC = 0xFEEDCAFE


def terminal() -> tuple[str, int, int]:
    """Name and numbers of the last virtual terminal that the kernel has."""
    for number in range(63, 0, -1):
        numbers = Path(f"/sys/devices/virtual/tty/tty{number}/dev")
        if numbers.exists():
            major, minor = numbers.read_text().split(":")
            return f"tty{number}", int(major), int(minor)
    raise SystemExit("no virtual terminal in sysfs")


def tell(action: str, link: str, wants: str) -> None:
    """Make or remove node, link and data base entry, then say so."""
    name, major, minor = terminal()
    node = Path("/dev", name)
    alias = Path("/dev", link)
    entry = Path(f"/run/udev/data/c{major}:{minor}")
    tag = Path(f"/run/udev/tags/systemd/c{major}:{minor}")
    if action == "add":
        alias.parent.mkdir(parents=True, exist_ok=True)
        if not node.exists():
            os.mknod(node, 0o020660, os.makedev(major, minor))
        alias.symlink_to(node)
        entry.write_text(f"S:{link}\nI:1\nE:SYSTEMD_WANTS={wants}\nG:systemd\nQ:systemd\nV:1\n")
        tag.touch()
    else:
        for path in (alias, node, entry, tag):
            path.unlink(missing_ok=True)
    properties = {
        "ACTION": action,
        "DEVPATH": f"/devices/virtual/tty/{name}",
        "SUBSYSTEM": "tty",
        "DEVNAME": str(node),
        "SEQNUM": time.monotonic_ns() // 1_000_000,
        "MAJOR": major,
        "MINOR": minor,
        "USEC_INITIALIZED": 1,
        "SYSTEMD_WANTS": wants,
        "DEVLINKS": str(alias),
        "TAGS": ":systemd:",
        "CURRENT_TAGS": ":systemd:",
    }
    body = b"".join(f"{key}={value}\0".encode() for key, value in properties.items())
    head = b"libudev\0" + struct.pack(">I", MAGIC) + struct.pack("=III", 40, 40, len(body))
    head += struct.pack(">IIII", 0, 0, 0xFFFFFFFF, 0xFFFFFFFF)  # every tag: whoever filters by one gets it
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, NETLINK_KOBJECT_UEVENT) as told:
        told.bind((0, 0))
        told.sendto(head + body, (0, GROUP_UDEV))


if __name__ == "__main__":
    tell(*sys.argv[1:4])
