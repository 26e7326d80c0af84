"""What a daemon before us left in the service manager's store: kept there until a front has written it."""

import os
from collections.abc import Callable

FRONTS = 2  # that get it: should they die of it, it is given up


class CrashRecording:
    """The flight recorder of a daemon that is gone; `fd` is None where there is none, or no longer."""

    def __init__(self, fd: int | None) -> None:
        """`fd` is ours to close."""
        self.fd = fd
        self.then: Callable[[], None] = lambda: None  # called once, when nothing more will be done about it
        self._left = FRONTS

    def offer(self) -> None:
        """A front is about to be started: it gets `fd`, if others have not died of it."""
        if self.fd is not None and not self._left:
            self.done()

    def taken(self) -> None:
        """That front was started."""
        self._left -= 1

    def done(self) -> None:
        """It is written down, or cannot be."""
        if self.fd is not None:
            self.close()
            self.then()

    def close(self) -> None:
        """Let go of it here; the store keeps it."""
        if self.fd is not None:
            os.close(self.fd)
            self.fd = None
