"""Bench of a tuning on a robot through its daemon: a client with the lease, every step past the gate."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from twind.client import ClientError, Refused
from twind.command_line.verb import Rejected
from twind.exceptions import InvalidInput
from twind.identification.live_excitation import SMALLER, MessageRecorder, require_path_limits
from twind.robot.finding import ReasonCode
from twind.robot_client.robot import Robot
from twind.tuning.gain_search import Gains
from twind.tuning.step_response import LEAST_STEP, StepResponse, measure_steps, step_motion

PATIENCE = 5.0  # s until the bus has read that torque is off
AFTER = 0.3  # s that are recorded after a motion


class StepBench:
    """Moves the joints of one type; `TuningBench` of `twind/tuning/gain_tuning.py`."""

    def __init__(
        self,
        robot: Robot,
        listener: Callable[[], Any],
        joints: Mapping[str, Mapping[str, Any]],
        file_gains: Gains,
        step: float,
    ) -> None:
        """`joints`: as GetRobot describes them, by name; `step`: rad, at most. Raises Rejected, ClientError.

        `listener` opens an observer.
        """
        if robot.status["mode"] != "live" or not robot.armed:
            raise Rejected("gains are tuned on an armed robot in mode live: `twindctl arm`")
        self._robot = robot
        self._listener = listener
        self._joints = joints
        self._kind = str(next(iter(joints.values()))["type"]["name"])
        self._file_gains = file_gains
        self._step = step
        self._way: dict[str, float] = {}  # rad, of each joint, once the gate has let it pass
        limits = robot.limits  # a joint that rests on its stop is a little beyond
        goals = {name: reading.goal for name, reading in robot.joints.items()}
        self._place = {
            name: float(np.clip(at, *limits[name])) for name, at in goals.items() if at is not None
        }

    def apply(self, gains: Gains) -> None:
        """Rest pose, torque off, gains, torque on, back to the place. Raises Rejected, ClientError."""
        self._put(gains)
        self._robot.arm()
        with self._listener() as client:
            described = client.call("GetRobot")["robot"]["joints"]
        now = next(each["type"]["gains"] for each in described if each["name"] in self._joints)
        if any(now[name] != value for name, value in gains.items()):  # under torque they stay as they are
            raise Rejected(f"another client changed the gains of {self._kind} to {now}: tune again, alone")
        self._robot.move(self._place, retime=True)

    def restore(self) -> None:
        """Put the gains of the robot file in force. Raises Rejected: the daemon will do so, at rest."""
        try:
            self._put(self._file_gains)
        except ClientError as error:
            raise Rejected(
                f"{error}; the daemon puts the gains of the robot file back as soon as torque is off"
            ) from error

    def step(self, joint: str) -> StepResponse:
        """Step a joint there and back. Raises Rejected: it is warm, or its path is refused; ClientError."""
        reading = self._robot.joints[joint]
        bound = float(self._joints[joint]["type"]["heat"]["cool"])
        if reading.temperature is not None and reading.temperature > bound:
            raise Rejected(
                f"{joint} has {reading.temperature:g} °C, above {bound:g}: let it cool, then go on"
            )
        refusal: Refused | None = None
        for way in [self._way[joint]] if joint in self._way else self._ways(joint):
            try:
                found = self._measured(joint, way)
            except Refused as error:
                require_path_limits(error)
                refusal = error
                continue
            self._way[joint] = way
            return found
        raise Rejected(
            f"{joint}: the gate refuses a step: {refusal or 'there is no room between its limits'}"
        )

    def _ways(self, joint: str) -> list[float]:
        """Return steps, rad, in the order in which they are asked for: towards the middle first."""
        described = self._joints[joint]
        start = self._place[joint]
        middle = 0.5 * (described["lower"] + described["upper"])
        side = 1.0 if start <= middle else -1.0
        ways = [sign * share * self._step for share in SMALLER for sign in (side, -side)]
        inside = [way for way in ways if described["lower"] <= start + way <= described["upper"]]
        return [way for way in inside if abs(way) >= LEAST_STEP]

    def _measured(self, joint: str, way: float) -> StepResponse:
        described = self._joints[joint]
        start = self._place[joint]
        limits = (described["velocity_limit"], described["acceleration_limit"])
        positions, times = step_motion(start, start + way, *limits)
        points = [
            {"positions": [at], "velocities": [0.0], "time_from_start": stamp}
            for at, stamp in zip(positions.tolist(), times.tolist(), strict=True)
        ]
        with MessageRecorder(self._listener()) as recorder:
            self._robot.submit({"joint_names": [joint], "points": points})
            end = self._robot.state.stamp + AFTER
            next(state for state in self._robot.states() if state.stamp > end)
        row = self._robot.names.index(joint)
        columns = [
            np.array([_number(message["joints"][row][key]) for message in recorder.messages])
            for key in ("goal", "position")
        ]
        stamps = np.array([float(message["time"]) for message in recorder.messages])
        if len(stamps) == 0:
            raise InvalidInput("no state was received")
        return measure_steps(stamps, *columns)

    def _put(self, gains: Gains) -> None:
        """Put gains in force; a bus needs a moment after the torque to be at rest."""
        last = self._robot.state.stamp + PATIENCE
        for state in self._robot.states():
            try:
                self._robot.try_gains(self._kind, gains)
                return
            except Refused as refusal:
                codes = {finding.get("code") for finding in refusal.findings}
                if codes != {ReasonCode.BUSY} or state.stamp > last:
                    raise


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
