"""Excitation of a robot through its daemon: each joint alone, then all together, every motion past the gate.

An ordinary client with the lease. A path that the gate refuses for its limits is tried again smaller; every
other refusal ends the run. A joint that is warm is left out.
"""

import threading
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twind.client import Refused
from twind.command_line.phase_lines import StepReport, no_report
from twind.identification.excitation import RATE, ExcitationBounds, excite
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind.robot_client.robot import Robot

SMALLER = (1.0, 0.6, 0.35, 0.2)  # shares of the amplitude that are tried in turn
TOGETHER = 0.6  # share of the amplitude when all joints move
LONGEST = 900.0  # s of robot in all
WARM = 55.0  # °C above which a joint is not excited
# Refusals of a path that a smaller one may avoid; of a longer one too, as its slow parts become shorter.
PATH_LIMITS = frozenset(
    (
        ReasonCode.POS_LIMIT,
        ReasonCode.VEL_LIMIT,
        ReasonCode.ACC_LIMIT,
        ReasonCode.BRAKE_DISTANCE,
        ReasonCode.START_JUMP,
        ReasonCode.SELF_COLLISION,
        ReasonCode.KEEP_OUT,
        ReasonCode.FLOOR,
        ReasonCode.TORQUE_INFEASIBLE,
        ReasonCode.TOO_MANY_POINTS,
    )
)


class MessageRecorder:
    """Keeps the states that the daemon sends, in a thread, while motions run. A context."""

    def __init__(self, socket: Any) -> None:
        """`socket`: a connected client whose stream of states is read."""
        self._client = socket
        self.messages: list[Mapping[str, Any]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)

    def __enter__(self) -> "MessageRecorder":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(timeout=2.0)
        self._client.close()

    @property
    def seconds(self) -> float:
        """Time of the daemon from the first state to the newest, s."""
        return self.messages[-1]["time"] - self.messages[0]["time"] if self.messages else 0.0

    def _read(self) -> None:
        for message in self._client.stream("Monitor", topics=["state"], rate=1000.0):
            self.messages.append(message)
            if self._ended.is_set():
                return


def excite_robot(
    robot: Robot,
    client: Any,
    described: Mapping[str, Any],
    joints: Sequence[str],
    amplitude: float,
    report: StepReport = no_report,
) -> list[Mapping[str, Any]]:
    """Move the joints and return the states of all of it; empty: each was too warm, or refused for its path.

    `client`: an observer; `described`: the robot as GetRobot answers; `report`: gets each motion.
    Raises Refused: for another reason than the limits of a path, such as an e-stop or a lease that an
    operator took; ClientError.
    """
    bounds = {each["name"]: _bounds(each) for each in described["joints"] if each["name"] in joints}
    parts = [(name, {name: bounds[name]}, amplitude) for name in joints]
    if len(joints) > 1:
        parts.append(("all joints together", bounds, TOGETHER * amplitude))
    planned = [_duration(robot, part, reach) for _, part, reach in parts]
    whole = min(sum(planned), LONGEST)
    moved = False
    with MessageRecorder(client) as recorder:
        for place, (what, part, reach) in enumerate(parts):
            if recorder.seconds >= LONGEST:
                break
            share = min(sum(planned[:place]) / whole, 1.0)
            report(f"moves {what} ({place + 1} of {len(parts)})", share, whole)
            done = _try(robot, part, reach)
            moved |= done and len(part) == 1
    return recorder.messages if moved else []


def motion_of(
    bounds: Mapping[str, ExcitationBounds], start: Mapping[str, float], amplitude: float
) -> tuple[Floats, Floats]:
    """Return points (k, n) and times (k,), s, of joints that move differently at the same time."""
    count = len(bounds)
    columns = [
        excite(start[name], each, amplitude, place / count)
        for place, (name, each) in enumerate(bounds.items())
    ]
    length = max(map(len, columns))
    points = np.stack([np.pad(column, (0, length - len(column)), mode="edge") for column in columns], axis=-1)
    return points, np.arange(1, length + 1) / RATE


def _duration(robot: Robot, bounds: Mapping[str, ExcitationBounds], amplitude: float) -> float:
    """Return the duration of a motion that the gate does not slow down, s."""
    readings = robot.joints
    return float(motion_of(bounds, {name: readings[name].goal or 0.0 for name in bounds}, amplitude)[1][-1])


def _try(robot: Robot, bounds: Mapping[str, ExcitationBounds], amplitude: float) -> bool:
    """Move joints as far as the gate lets them; False: refused for limits of the path, or too warm."""
    readings = robot.joints
    start = {name: readings[name].goal for name in bounds if not _is_warm(readings[name])}
    held = {name: goal for name, goal in start.items() if goal is not None}
    cool = {name: bounds[name] for name in held}
    if not cool:
        return False
    for share in SMALLER:
        points, times = motion_of(cool, held, share * amplitude)
        try:
            robot.follow(list(cool), points, times, retime=True)
        except Refused as refusal:
            require_path_limits(refusal)
            continue
        return True
    return False


def require_path_limits(refusal: Refused) -> None:
    """Raise a refusal again unless a smaller motion may pass: all its findings are limits of the path."""
    codes = {str(finding.get("code")) for finding in refusal.findings}
    if not codes or not codes <= PATH_LIMITS:
        raise refusal


def _is_warm(reading: Any) -> bool:
    temperature = getattr(reading, "temperature", None)
    return temperature is not None and temperature > WARM


def _bounds(joint: Mapping[str, Any]) -> ExcitationBounds:
    return ExcitationBounds(
        joint["lower"], joint["upper"], joint["velocity_limit"], joint["acceleration_limit"]
    )
