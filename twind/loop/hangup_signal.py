"""SIGHUP from the first moment on: it ends no daemon that is still starting. Loop's process, main thread."""

import os
import signal
from collections.abc import Callable
from types import FrameType


class HangupSignal:
    """The files are read again (daemon(7)); where the terminal that we were started from is gone, we end.

    Kept until there is somebody to `tell`: a start reads files and compiles a model first.
    """

    def __init__(self) -> None:
        # Who was started under nohup has asked not to be ended by it.
        self._in_terminal = has_terminal() and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN
        self._reread: Callable[[], None] | None = None
        self._end: Callable[[], None] | None = None
        self._came = False
        signal.signal(signal.SIGHUP, self._hang_up)

    def enable_delivery(self, *, reread: Callable[[], None], end: Callable[[], None]) -> None:
        """From now on who hangs up is heard at once; who has done so already, now."""
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
    """We have a controlling terminal; the kernel takes it away before it tells that it hung up (tty(4))."""
    try:
        os.close(os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC))
    except OSError:
        return False
    return True
