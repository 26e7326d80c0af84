"""The lease of one connection, kept by a thread until it is given back."""

import contextlib
import threading

from twind.client import Client, ClientError

PERIOD = 0.1  # s; a lease lasts 1 s, and 0.25 s while setpoints are streamed


class LeaseRenewal:
    """Renews the lease while `start`ed. The thread sends calls without an answer, beside other calls.

    A process that is stopped or killed renews nothing: the lease ends, and a motion holds. A program that
    hangs keeps the lease, not its motion: a trajectory ends, and goals are followed for 0.1 s at most.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to renew; nothing more if it has begun."""
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._run, name="lease", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Renew no more."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(PERIOD):
            # The next call of the owner reports it; the owner may close the socket meanwhile.
            with contextlib.suppress(ClientError, OSError, ValueError):
                self._client.notify("RenewLease")
