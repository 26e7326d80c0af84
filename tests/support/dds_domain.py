"""A DDS domain for one test: a number that nobody else on this machine has at the moment.

DDS speaks UDP on the ports 7400 + 250 × domain and after; the TCP port of the same number is the lock.
"""

import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager

DOMAINS = range(1, 100)  # of higher ones the ports are those that the kernel gives to anybody
PARTICIPANTS = 8  # of one domain whose ports have to be free


@contextmanager
def free_domain() -> Iterator[int]:
    """The domain is the caller's until the end of the block."""
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as lock:
            try:
                lock.bind(("127.0.0.1", 7400 + 250 * domain))
            except OSError:
                continue
            if _unused(domain):
                yield domain
                return
    raise AssertionError("no DDS domain is free")


def _unused(domain: int) -> bool:
    for port in range(7410 + 250 * domain, 7410 + 250 * domain + 2 * PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                return False
    return True
