"""One walk of a robot: goals of the walking engine as a stream through the gate, until it stands again."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from twind.client import MotionFailed, Refused
from twind.exceptions import InvalidInput
from twind.protocol.messages import FindingMessage
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind.robot_client.goal_stream import GoalStream
from twind.robot_client.snapshot import JointReading, RobotSnapshot
from twind.walk.balance import tilt_of
from twind.walk.walking_engine import WalkingEngine

RATE = 100.0  # Hz
FALLEN = 0.6  # rad of tilt from which no step helps
NEAR = 0.05  # rad: joints this near to the stance need no motion to it
MOST_ELAPSED = 0.03  # s that the gait goes on at once after missed periods
LATCHED = (ReasonCode.FAULT_LATCHED, ReasonCode.ESTOP_LATCHED)  # the daemon reacts: no e-stop of this program
RECENT = 0.05  # s: an older reading of the IMU does not balance
# Velocities at which h24-standing walked without a refusal: forward, left, m/s; turn, rad/s.
FASTEST = np.array([0.12, 0.03, 0.25])

# seconds since the start -> forward, left, turn; None: stop, stand, end
Command = Callable[[float], Floats | None]


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


def velocity(forward: float, left: float, turn: float) -> Floats:
    """Return a command (3,). Raises InvalidInput: faster than what was tried."""
    wanted = np.array([forward, left, turn])
    for name, value, most in zip(("forward", "left", "turn"), wanted.tolist(), FASTEST.tolist(), strict=True):
        if not abs(value) <= most:
            raise InvalidInput(f"walk: {name} {value:g} is outside -{most:g} to {most:g}")
    return wanted


def run_walk(robot: WalkingRobot, engine: WalkingEngine, command: Command) -> WalkOutcome:
    """Walk until `command` returns None and the robot stands.

    Raises Refused: a fault or an e-stop was latched, such as for a fall that the daemon detected;
    MotionFailed: it fell, and was stopped by an e-stop; else as `GoalStream.send`.
    """
    goals = np.array([joint.goal for joint in robot.joints.values()])
    if not (np.abs(goals - engine.stance) <= NEAR).all():
        robot.move(dict(zip(robot.names, engine.stance.tolist(), strict=True)), retime=True)
    ending = False
    now = before = 0.0
    with robot.stream(rate=RATE, strict=False) as stream:
        for now in stream:
            wanted = None if ending else command(now)
            ending = wanted is None
            if ending and engine.standing:
                break
            refusal = stream.report.refusal
            if isinstance(refusal, Refused) and any(each["code"] in LATCHED for each in refusal.findings):
                raise refusal
            inertial = robot.state.message.inertial
            tilt = 0.0 if inertial is None else max(map(abs, tilt_of(inertial.quaternion)))
            if tilt > FALLEN:
                robot.estop(reason="fell while walking")
                raise MotionFailed("aborted", [_fall(tilt, now, engine.steps)])
            fresh = inertial is not None and inertial.age <= RECENT
            stream.send(
                engine.advance(
                    min(max(now - before, stream.period), MOST_ELAPSED),
                    np.zeros(3) if wanted is None else wanted,
                    inertial.quaternion if inertial is not None and fresh else None,
                    inertial.gyro if inertial is not None and fresh else None,
                )
            )
            before = now
    return WalkOutcome(engine.steps, now, stream.report.refused, stream.report.late)


def _fall(tilt: float, time: float, steps: int) -> FindingMessage:
    message = f"fell after {steps} steps: tilt of the base (rad); it was stopped by an e-stop"
    return {
        "code": ReasonCode.UNSTABLE_POSE,
        "joint": None,
        "point": None,
        "time": time,
        "value": tilt,
        "bound": FALLEN,
        "message": message,
    }
