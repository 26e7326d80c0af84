"""Verbs that go on until they are told to stop. Standard library only."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def told_to_stop() -> Iterator[threading.Event]:
    """Set by Ctrl-C, SIGTERM and a terminal that is closed, unless whoever started us wants that ignored."""
    stop = threading.Event()
    signals = [each for each in STOPS if signal.getsignal(each) != signal.SIG_IGN]
    usual = {each: signal.signal(each, lambda *_: stop.set()) for each in signals}
    try:
        yield stop
    finally:
        for each, handler in usual.items():
            signal.signal(each, handler)
