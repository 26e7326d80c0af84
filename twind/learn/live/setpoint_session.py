"""Driving session of a learner: the lease, a motion to a pose, and setpoints, on one connection.

All of it passes the gate.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from twind.client import Client, ClientError
from twind.client.errors import finding_text
from twind.client.move_duration import present_goals, slow_duration
from twind.exceptions import OperationFailed
from twind.robot.arrays import Floats
from twind.robot_client.control_timing import validity

PATIENCE = 1.0  # s for an answer to a setpoint: the loop gives it within a tick
WAY = 130.0  # s for reports of a way
ROUNDING = 1e-6  # s


class SetpointSession:
    """Holds the lease of a robot from `__init__` to `drop`."""

    def __init__(self, client: Client, joints: Sequence[str], period: float, *, take: bool = False) -> None:
        """`period`: s between setpoints. Raises ClientError: another holds the lease."""
        self._client = client
        self._joints = list(joints)
        self._dropped = False
        self._period = period
        self._valid_for = validity(period)
        self.take(by_force=take)

    def take(self, *, by_force: bool = False) -> None:
        """Take the lease, if it is free or this session's own. Raises ClientError: another holds it."""
        self._client.call("AcquireLease", take=by_force or None)

    def go(self, pose: Floats, is_stopped: Callable[[], bool] = lambda: False) -> bool:
        """Move to `pose` (n,), rad, and stop there. False: `is_stopped` ended the wait on the way.

        Raises OperationFailed, ClientError (Refused: by the gate).
        """
        goals = dict(zip(self._joints, pose.tolist(), strict=True))
        point = {
            "positions": pose.tolist(),
            "velocities": [0.0] * len(pose),
            "time_from_start": slow_duration(goals, present_goals(self._client)),
        }
        last: Mapping[str, Any] = {}
        self._client.timeout = WAY
        trajectory = {"joint_names": self._joints, "points": [point], "policy": "retime"}
        for report in self._client.stream("SubmitTrajectory", trajectory=trajectory):
            last = report
            if is_stopped():
                return False
        self._client.timeout = PATIENCE
        if last.get("phase") != "succeeded":
            why = "; ".join(map(finding_text, last.get("findings") or ()))
            raise OperationFailed(
                f"the way to the default pose {last.get('phase')}: {why or 'no reason given'}"
            )
        return True

    def send(self, position: Floats, velocity: Floats, *, wait: bool = False) -> None:
        """Send the current positions of the joints, rad, and the velocities that follow, rad/s, (n,).

        The gate answers within one or two ticks, which may be longer than a period. So the answer is taken
        with the next call, unless `wait`. Raises ClientError. Refused means this setpoint, or the one before,
        and then this one was not sent.
        """
        self._client.finish()
        self._client.begin(
            "Setpoint",
            joint_names=self._joints,
            positions=position.tolist(),
            velocities=velocity.tolist(),
            valid_for=self._valid_for,
        )
        if wait:
            self._client.finish()

    def settle(self) -> None:
        """Take the answer to the last setpoint. Raises ClientError (Refused)."""
        self._client.finish()

    def lapses(self, missed: int) -> bool:
        """Return whether a setpoint may lapse after `missed` periods without another."""
        return (missed + 1) * self._period >= self._valid_for - ROUNDING

    def keep(self) -> None:
        """Keep the lease while nothing is sent. Raises ClientError (Refused: the last setpoint)."""
        self._client.finish()
        self._client.call("RenewLease")

    def drop(self) -> None:
        """Give the lease back, if it is still ours: the robot then holds. May be called twice.

        It sends no Cancel, which would stop the present lease holder. On a lost connection it sends nothing:
        the lease went with it, and a new connection could reach another daemon.
        """
        if self._client.connected and not self._dropped:
            with contextlib.suppress(ClientError):
                self._client.finish()
            with contextlib.suppress(ClientError, RuntimeError):
                if self._client.connected:
                    self._client.call("ReleaseLease")
        self._dropped = True
        self._client.close()
