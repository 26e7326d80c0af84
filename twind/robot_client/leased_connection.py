"""One connection with the lease, shared by the threads of a program: calls, motions, stops between them."""

import contextlib
import threading
from collections.abc import Mapping
from contextlib import closing
from typing import Any

from twind.client import Client, ClientError, Disconnected, MotionFailed, NoAnswer, Refused
from twind.robot_client.lease_renewal import LeaseRenewal
from twind.robot_client.motion_outcome import MotionOutcome, outcome_of

UNDER_WAY = ("accepted", "running")  # phases of a motion that goes on
SETPOINT = 2.0  # s for the answer to a setpoint: the lease of a stream lapses long before
MOTION = 130.0  # s without a report of a motion: its start may lie 60 s ahead


class LeasedConnection:
    """Calls of one connection, one at a time; it reconnects after a restart of the daemon.

    The lease is taken by the first command and kept until `close`. A motion call is never repeated.
    """

    def __init__(self, client: Client, *, take: bool = False) -> None:
        """`take`: take the lease from another holder, at the first command; who takes it later keeps it."""
        self.client = client
        self._take = take
        self._calling = threading.RLock()
        self._renewal = LeaseRenewal(client)
        self._leased = False
        self._closed = False
        self.stops = 0  # calls of `note_stop`: a motion that was asked for before one does not begin

    def close(self) -> None:
        """Give the lease back and disconnect, for good. May be called twice."""
        self._renewal.stop()
        with self._calling:
            if self._leased and self.client.connected:
                with contextlib.suppress(ClientError, RuntimeError):
                    self.client.call("ReleaseLease")
            self._leased = False
            self._closed = True
            self.client.close()

    @property
    def leased(self) -> bool:
        """True if this connection took the lease and knows of no loss."""
        return self._leased

    def call(self, method: str, **parameters: Any) -> Mapping[str, Any]:
        """Call. Raises ClientError."""
        with self._calling:
            self.require_open()
            self._connect()
            return self.client.call(method, **parameters)

    def command(self, method: str, **parameters: Any) -> Mapping[str, Any]:
        """Call with the lease. Raises ClientError."""
        with self._calling:
            self._take_lease()
            try:
                return self.client.call(method, **parameters)
            except Refused as refusal:
                self._forget_lost_lease(refusal)
                raise

    def setpoint(self, stops: int, **parameters: Any) -> Mapping[str, Any]:
        """Send a setpoint at once or not at all: one that waited for another call would be followed late.

        `stops`: as counted when its stream began. Raises NoAnswer: another call is under way, or there is no
        answer within `SETPOINT`; MotionFailed: stopped since; ClientError.
        """
        if not self._calling.acquire(timeout=parameters["valid_for"]):
            raise NoAnswer("a goal was not sent: another call of this Robot is under way")
        try:
            self.require_unstopped(stops)
            with self.client.within(SETPOINT):
                return self.command("Setpoint", **parameters)
        finally:
            self._calling.release()

    def run(self, trajectory: Mapping[str, Any], stops: int) -> MotionOutcome:
        """Run a trajectory to its end, unless it was stopped since `stops` were counted.

        An exception on the way, such as KeyboardInterrupt, closes the connection: the robot holds. Raises
        MotionFailed, ClientError.
        """
        with self._calling:
            self._take_lease()
            last: Mapping[str, Any] = {}
            try:
                self.require_unstopped(stops)
                with (
                    self.client.within(MOTION),
                    closing(self.client.stream("SubmitTrajectory", trajectory=trajectory)) as reports,
                ):
                    for report in reports:
                        last = report
                        if self.stops != stops and report["phase"] in UNDER_WAY:
                            stops = self.stops
                            self.client.notify("Cancel")  # that stop may have arrived before the trajectory
            except Refused as refusal:
                self._forget_lost_lease(refusal)
                raise
        return outcome_of(last)

    def note_stop(self) -> None:
        """Count a stop, and cancel at once what this connection runs. From any thread."""
        self.stops += 1
        if self.client.connected:
            self.client.notify("Cancel")

    def require_unstopped(self, stops: int) -> None:
        """Raise MotionFailed if a stop came since `stops` were counted."""
        if self.stops != stops:
            raise MotionFailed("cancelled", ())

    def require_open(self) -> None:
        """Raise Disconnected after `close`."""
        if self._closed:
            raise Disconnected(f"{self.client.path}: this Robot was closed; make a new one")

    def _connect(self) -> None:
        """Reconnect after a restart of the daemon, whose new process knows no lease of ours."""
        if self.client.is_hung_up():
            self.client.close()
        if not self.client.connected:
            self.client.connect()
            self._leased = False

    def _take_lease(self) -> None:
        self.require_open()
        self._connect()
        if not self._leased:
            self.client.call("AcquireLease", take=self._take or None)
            self._take = False
            self._leased = True
            self._renewal.start()

    def _forget_lost_lease(self, refusal: Refused) -> None:
        """Take the lease anew at the next call where this one was refused for want of it."""
        if any(each["code"] == "LEASE_MISSING" for each in refusal.findings):
            self._leased = False
