"""Stop signals of verbs that run until they are ended. Standard library only."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def catch_stop_signals() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C, SIGTERM and a closed terminal set.

    Signals that the parent process ignores stay ignored.
    """
    stop = threading.Event()
    signals = [each for each in STOPS if signal.getsignal(each) != signal.SIG_IGN]
    usual = {each: signal.signal(each, lambda *_: stop.set()) for each in signals}
    try:
        yield stop
    finally:
        for each, handler in usual.items():
            signal.signal(each, handler)


@contextmanager
def interrupt_on_terminate() -> Iterator[None]:
    """Raise KeyboardInterrupt at SIGTERM, as at Ctrl-C: a script that ends a verb gets its last report."""
    usual = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, usual)
