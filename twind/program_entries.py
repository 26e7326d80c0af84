"""Entry points of the programs: Ctrl-C while one is imported ends it with 130, without a traceback.

The same holds while it runs, for a Ctrl-C that the program itself does not handle.

Imports the standard library alone, so that little can be interrupted before it acts.
"""

import importlib
import os
import signal
from types import FrameType

INTERRUPTED = 130  # as a shell reports SIGINT


def daemon() -> int:
    """Entry point of `twind`."""
    return start("twind.cli")


def control() -> int:
    """Entry point of `twindctl`."""
    return start("twind.ctl.ctl_main")


def virtual() -> int:
    """Entry point of `twind-virtual`."""
    return start("twind.virtual.virtual_main")


def start(module: str) -> int:
    """Import `module` and run its `main`; return its exit code, or 130 after a KeyboardInterrupt of either.

    SIGINT that is ignored stays ignored.
    """
    guarded = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    try:
        if guarded:
            signal.signal(signal.SIGINT, _end)  # an exception could be lost in the import of an extension
        main = importlib.import_module(module).main
        if guarded:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return int(main() or 0)
    except KeyboardInterrupt:
        return INTERRUPTED


def _end(number: int, frame: FrameType | None) -> None:
    """End the process during its imports: nothing is open yet."""
    os._exit(INTERRUPTED)
