"""One walk of a robot: goals of the walking engine as a stream through the gate, until it stands again."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from twind.client import MotionFailed, Refused
from twind.exceptions import InvalidInput
from twind.protocol.messages import FindingMessage
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind.robot.modes import RobotState
from twind.robot.recovery_steps import steps_text
from twind.robot_client.goal_stream import GoalStream, StreamReport
from twind.robot_client.snapshot import JointReading, RobotSnapshot
from twind.robot_client.state_message import ImuReading
from twind.walk.balance import tilt_of
from twind.walk.walking_engine import WalkingEngine

RATE = 100.0  # Hz
FALLEN = 0.6  # rad of tilt from which no step helps
NEAR = 0.05  # rad: joints this near to the stance need no motion to it
MOST_ELAPSED = 0.03  # s that the gait goes on at once after missed periods
LATCHED = (ReasonCode.FAULT_LATCHED, ReasonCode.ESTOP_LATCHED)  # the daemon reacts: no e-stop of this program
RECENT = 0.05  # s: an older reading of the IMU does not balance
ON_ITS_WAY = 0.1  # s: nor does one in a state that has come later, or that no newer one has followed
MOST_REFUSED = 3  # goals of a walk; a stopped robot refuses each
# Velocities at which h24-standing walked without a refusal: forward, left, m/s; turn, rad/s.
FASTEST = np.array([0.12, 0.03, 0.25])
STILL = (0.0, 0.0, 0.0)

# seconds since the start -> forward, left, m/s; turn, rad/s; None: stop, stand, end
Command = Callable[[float], tuple[float, float, float] | None]


@dataclass(frozen=True, slots=True)
class WalkOutcome:
    """Result of a walk that ended at rest."""

    steps: int
    seconds: float
    refused: int  # goals that the gate refused
    late: int  # periods that this program missed


class WalkingRobot(Protocol):
    """Members of `twind.Robot` that a walk uses."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def names(self) -> Sequence[str]: ...  # noqa: D102
    @property
    def joints(self) -> Mapping[str, JointReading]: ...  # noqa: D102
    @property
    def state(self) -> RobotSnapshot: ...  # noqa: D102
    def move(self, goals: Mapping[str, float], *, retime: bool = False) -> Any: ...  # noqa: D102
    def stream(self, *, rate: float, strict: bool) -> GoalStream: ...  # noqa: D102
    def estop(self, *, reason: str) -> None: ...  # noqa: D102


def velocity(wanted: tuple[float, float, float]) -> Floats:
    """Return a command (3,). Raises InvalidInput: faster than what was tried."""
    for name, value, most in zip(("forward", "left", "turn"), wanted, FASTEST.tolist(), strict=True):
        if not abs(value) <= most:
            raise InvalidInput(f"walk: {name} {value:g} is outside -{most:g} to {most:g}")
    return np.array(wanted)


def run_walk(
    robot: WalkingRobot, engine: WalkingEngine, command: Command, seconds: float | None = None
) -> WalkOutcome:
    """Walk for `seconds` or until `command` returns None; return when the robot stands.

    A command too fast, or an IMU that falls silent, ends the walk: it stands first. More than `MOST_REFUSED`
    refusals, as after a stop or an e-stop, end the goals at once. Raises InvalidInput: too fast, no goals or
    no IMU; Refused: as above, or a latched fault, such as a fall that the daemon detected; MotionFailed: it
    fell, and was stopped by an e-stop, or the IMU fell silent; else as `GoalStream.send`.
    """
    longest = math.inf if seconds is None else seconds
    velocity(command(0.0) or STILL)
    if _inertial(robot) is None:
        raise InvalidInput(
            f"walk: {robot.name} has no reading of an IMU newer than {RECENT:g} s to balance by"
        )
    goals = [joint.goal for joint in robot.joints.values()]
    if None in goals:
        raise InvalidInput(f"walk: {robot.name} follows no goals: arm it first")
    if not (np.abs(np.array(goals) - engine.stance) <= NEAR).all():
        robot.move(dict(zip(robot.names, engine.stance.tolist(), strict=True)), retime=True)
    failure: Exception | None = None
    wanted: Floats | None = np.zeros(3)
    now = before = 0.0
    with robot.stream(rate=RATE, strict=False) as stream:
        for now in stream:
            _raise_latched(stream.report)
            inertial = _inertial(robot)
            if inertial is not None and not max(map(abs, tilt_of(inertial.quaternion))) <= FALLEN:
                robot.estop(reason="fell while walking")
                raise MotionFailed("aborted", [_fall(inertial, now, engine.steps)])
            try:
                wanted = None if wanted is None else _wanted(command, now, longest)
            except InvalidInput as error:
                failure = error
                wanted = None
            if inertial is None and failure is None:
                failure = MotionFailed("aborted", [_silence(now)])
                wanted = None
            if wanted is None and engine.standing:
                break
            stream.send(
                engine.advance(
                    min(max(now - before, stream.period), MOST_ELAPSED),
                    np.zeros(3) if wanted is None else wanted,
                    None if inertial is None else inertial.quaternion,
                    None if inertial is None else inertial.gyro,
                )
            )
            before = now
    if failure is not None:
        raise failure
    return WalkOutcome(engine.steps, now, stream.report.refused, stream.report.late)


def _raise_latched(report: StreamReport) -> None:
    """Raise the refusal of a stopped robot: a latched fault or e-stop, else more than `MOST_REFUSED`."""
    refusal = report.refusal
    if refusal is None:
        return
    latched = isinstance(refusal, Refused) and any(each["code"] in LATCHED for each in refusal.findings)
    if latched or report.refused > MOST_REFUSED:
        raise refusal


def _wanted(command: Command, now: float, longest: float) -> Floats | None:
    """Return the velocity (3,) now; None: stop. Raises InvalidInput: too fast."""
    found = command(now) if now < longest else None
    return None if found is None else velocity(found)


def _inertial(robot: WalkingRobot) -> ImuReading | None:
    """Return the reading of the IMU; None: there is none, or an old one."""
    state = robot.state
    found = state.message.inertial
    return found if found is not None and found.age <= RECENT and state.elapsed <= ON_ITS_WAY else None


def _fall(inertial: ImuReading, time: float, steps: int) -> FindingMessage:
    codes = (ReasonCode.ESTOP, ReasonCode.FALLING)
    after = steps_text(RobotState.ESTOP, codes, torque_on=None, live=True)  # the e-stop has just begun
    message = f"fell after {steps} steps: tilt of the base (rad); it was stopped by an e-stop; {after}"
    tilt = max(map(abs, tilt_of(inertial.quaternion)))
    return _finding(ReasonCode.UNSTABLE_POSE, time, message, tilt, FALLEN)


def _silence(time: float) -> FindingMessage:
    message = "the IMU fell silent: it stands; no reading for so long (s)"
    return _finding(ReasonCode.STATE_STALE, time, message, RECENT, RECENT)


def _finding(code: ReasonCode, time: float, message: str, value: float, bound: float) -> FindingMessage:
    return {
        "code": code,
        "joint": None,
        "point": None,
        "time": time,
        "value": value,
        "bound": bound,
        "message": message,
    }
