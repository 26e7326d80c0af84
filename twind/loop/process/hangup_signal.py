"""SIGHUP from the start of the process: it does not end a daemon that still starts.

Loop's process, main thread.
"""

import os
import signal
from collections.abc import Callable
from types import FrameType


class HangupSignal:
    """Handler of SIGHUP: reads the files again (daemon(7)), or ends the daemon when its terminal is gone.

    The signal is kept until `enable_delivery`: a start reads files and compiles a model first.
    """

    def __init__(self) -> None:
        # a process under nohup ignores SIGHUP and must not be ended by it
        self._in_terminal = has_terminal() and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN
        self._reread: Callable[[], None] | None = None
        self._end: Callable[[], None] | None = None
        self._came = False
        signal.signal(signal.SIGHUP, self._hang_up)

    def enable_delivery(self, *, reread: Callable[[], None], end: Callable[[], None]) -> None:
        """Deliver signals from now on at once, and one that came before now."""
        self._reread = reread
        self._end = end
        if self._came:
            self._hang_up(signal.SIGHUP, None)

    def _hang_up(self, number: int, frame: FrameType | None) -> None:
        self._came = True
        if self._reread is None or self._end is None:
            return
        if self._in_terminal and not has_terminal():
            self._end()
        else:
            self._reread()


def has_terminal() -> bool:
    """Check for a controlling terminal; the kernel removes it before it sends SIGHUP (tty(4))."""
    try:
        os.close(os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC))
    except OSError:
        return False
    return True
