"""Flight recorder of a former daemon, from the service manager's store, kept until a front has written it."""

import os
from collections.abc import Callable

FRONTS = 2  # fronts that receive it; if they die of it, it is given up, or no front would ever stay alive


class FormerFlightRecorder:
    """Flight recorder of a former daemon; `fd` is None without one, or once it is done."""

    def __init__(self, fd: int | None) -> None:
        """`fd` is closed by this object."""
        self.fd = fd
        self.then: Callable[[], None] = lambda: None  # called once, when the recording is done
        self._left = FRONTS

    def offer(self) -> None:
        """Prepare the start of a front: give the recording up if earlier fronts died of it."""
        if self.fd is not None and not self._left:
            self.done()

    def taken(self) -> None:
        """Count a front that was started with it."""
        self._left -= 1

    def done(self) -> None:
        """End the recording: it is written, or cannot be."""
        if self.fd is not None:
            self.close()
            self.then()

    def close(self) -> None:
        """Close `fd` in this process; the store of the service manager keeps its copy."""
        if self.fd is not None:
            os.close(self.fd)
            self.fd = None
