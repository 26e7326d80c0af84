"""`twind.Robot`: one robot, driven through its daemon in a few lines."""

import os
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from math import inf, radians
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from twind.client import Client, ClientError, NoAnswer
from twind.client.move_duration import goals_of, slow_duration
from twind.command_line.trajectory_files import load_motion
from twind.command_line.verb import Rejected, UsageError
from twind.exceptions import InvalidInput
from twind.robot.modes import RobotState
from twind.robot_client.daemon_robot_file import robot_file_of
from twind.robot_client.goal_stream import GoalStream
from twind.robot_client.leased_connection import LeasedConnection
from twind.robot_client.motion_outcome import MotionOutcome
from twind.robot_client.require_armed import require_armed
from twind.robot_client.snapshot import JointReading, RobotSnapshot
from twind.robot_client.state_subscriber import StateSubscriber

if TYPE_CHECKING:
    from twind.robot_client.walk_run import WalkOutcome

FIRST = 2.0  # s for the first state
STOP = 2.0  # s for the answer to a stop


class Robot:
    """A robot and its daemon.

    with Robot() as robot:
        robot.arm()
        robot.move({"head_yaw": 0.5}, time=2)
        robot.play("wave")

    Angles are radians, or degrees where `degrees=True` is given; speeds are per second. Methods that move
    raise `Refused` with all reasons where the gate refuses. The lease is taken by the first call that needs
    it, kept until `close`, and taken again after a restart of the daemon, which leaves the robot disarmed.
    Leaving the context gives the lease back: a motion holds, and torque stays as it is. `stop` and `estop`
    may be called from any thread; other calls wait for the one under way.
    """

    def __init__(
        self,
        socket: str | os.PathLike[str] | None = None,
        *,
        read_only: bool = False,
        take: bool = False,
        disarm: bool = False,
        state_rate: float = 50.0,
    ) -> None:
        """Connect. Raises NoDaemon.

        `socket`: folder of the daemon's sockets; None: the usual places. `read_only`: as an observer, who
        needs no operator's rights. `take`: take the lease from another holder, at the first command
        only. `disarm`: disarm in `close`. `state_rate`: Hz of `state`.
        """
        self._socket = socket
        self._role = "observe" if read_only else "control"
        self._disarm = disarm
        self._state_rate = state_rate
        self._connection = LeasedConnection(Client(socket, name=self._role), take=take)
        self._listening_lock = threading.Lock()
        self._subscriber: StateSubscriber | None = None
        self._description: Mapping[str, Any] = self._connection.call("GetRobot")["robot"]

    def __enter__(self) -> "Robot":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except ClientError as failure:
            if error is None:
                raise
            error.add_note(f"{self.name} was not disarmed: {failure}")

    def close(self) -> None:
        """Disarm if asked for, give the lease back and disconnect. May be called twice."""
        try:
            if self._disarm and self._connection.leased:
                self.disarm()
        finally:
            self._connection.close()
            if self._subscriber is not None:
                self._subscriber.close()
                self._subscriber = None

    # ------------------------------------------------------------------------------------------ reading

    @property
    def name(self) -> str:
        """Name in the robot file."""
        return str(self._description["name"])

    @property
    def names(self) -> tuple[str, ...]:
        """Joints, in the robot's order."""
        return tuple(each["name"] for each in self._description["joints"])

    @property
    def poses(self) -> Mapping[str, Mapping[str, float]]:
        """Poses of the robot file: joint to rad; joints that are not named are 0."""
        return MappingProxyType(self._description["poses"])

    @property
    def limits(self) -> Mapping[str, tuple[float, float]]:
        """Limits of each joint, rad."""
        return {each["name"]: (each["lower"], each["upper"]) for each in self._description["joints"]}

    @property
    def status(self) -> Mapping[str, Any]:
        """Mode, state, faults, buses, loop: `Status` of the interface. Raises ClientError."""
        answer: Mapping[str, Any] = self._connection.call("GetStatus")["status"]
        return answer

    @property
    def armed(self) -> bool:
        """True while torque is on and motions are taken: not in a fault, nor on the way to the rest pose.

        Raises ClientError.
        """
        return _is_armed(self.status)

    @property
    def state(self) -> RobotSnapshot:
        """Newest state, with the age of each value. Raises NoAnswer: none within 2 s; ClientError."""
        subscriber = self._listening()
        if subscriber.newest is not None:
            return RobotSnapshot(self.names, subscriber.newest)
        return self._state_after(-1)

    @property
    def joints(self) -> Mapping[str, JointReading]:
        """The newest state by joint. Raises as `state`."""
        return self.state.joints

    def states(self, patience: float = FIRST) -> Iterator[RobotSnapshot]:
        """Yield each new state, without end. Raises NoAnswer: none came for `patience` s; ClientError."""
        sequence = -1
        while True:
            snapshot = self._state_after(sequence, FIRST if sequence < 0 else patience)
            sequence = snapshot.message.sequence
            yield snapshot

    def _state_after(self, sequence: int, patience: float = FIRST) -> RobotSnapshot:
        subscriber = self._listening()
        message = subscriber.after(sequence, time.monotonic() + patience)
        if message is None:
            why = subscriber.ended or "is the machine busy?"
            raise NoAnswer(f"{self.name}: no state within {patience:g} s; {why}")
        return RobotSnapshot(self.names, message)

    def _listening(self) -> StateSubscriber:
        with self._listening_lock:
            return self._subscribed()

    def _subscribed(self) -> StateSubscriber:
        self._connection.require_open()
        if self._subscriber is not None and self._subscriber.ended:
            self._subscriber.close()
            self._subscriber = None
        if self._subscriber is None:
            self._subscriber = StateSubscriber(
                Client(self._socket, name=self._role), self.names, self._state_rate
            )
        return self._subscriber

    # ------------------------------------------------------------------------------------------ torque

    def arm(self, *, limp: Collection[str] = ()) -> None:
        """Switch torque on where the robot is; nothing moves. Joints `limp` stay without torque.

        A robot that is armed so already stays as it is; only the lease is taken. Raises Refused, ClientError;
        InvalidInput for an unknown joint.
        """
        unknown = set(limp).difference(self.names) if limp else ()
        if unknown:
            raise InvalidInput(f"limp: no joint {sorted(unknown)[0]!r}; there are {', '.join(self.names)}")
        answer = self._connection.call("GetStatus", joints=True)
        off = {joint["name"] for joint in answer["joints"] if joint["torque"] is False}
        if _is_armed(answer["status"]) and off == set(limp):
            self._connection.command("RenewLease")
            return
        held = [name for name in self.names if name not in limp] if limp else None
        self._connection.command("Arm", joints=held)

    def disarm(self) -> None:
        """Move slowly to the rest pose, then switch torque off. Raises ClientError."""
        self._connection.call("Disarm")

    def try_gains(self, kind: str, gains: Mapping[str, float]) -> None:
        """Disarm, then put gains of a type of the robot file in force, while this Robot has the lease.

        All of the type's gains are given. After that the daemon puts those of the file back as soon as torque
        is off. Raises Refused, CallError: another client holds the lease; ClientError.
        """
        self._connection.command("RenewLease")
        self.disarm()
        self._connection.command("SetParameters", parameters={f"types.{kind}.gains": dict(gains)})

    def estop(self, *, cut: bool = False, reason: str = "") -> None:
        """Lower the robot, then switch torque off; `cut`: torque off now. Raises ClientError."""
        with Client(self._socket, name="observe") as client:  # every client may, whatever else is under way
            client.call("EStop", level="cut" if cut else None, reason=reason or None)

    def reset(self) -> None:
        """Acknowledge faults and e-stops; never arms. Raises Refused, ClientError."""
        self._connection.call("Reset")

    # ------------------------------------------------------------------------------------------ motion

    def move(
        self,
        goals: Mapping[str, float],
        *,
        time: float | None = None,
        degrees: bool = False,
        retime: bool = False,
    ) -> MotionOutcome:
        """Move joints to goals along a smooth path and stop there; return when they are there.

        `time`: s; without it slow, by the longest way. `retime`: slow down what is too fast, instead of
        refusing it. Raises Refused: the gate refused; MotionFailed: it was stopped or replaced; ClientError;
        InvalidInput: a goal is no number.
        """
        stops = self._connection.stops
        if not goals:
            raise InvalidInput("move: no goals")
        scale = radians(1.0) if degrees else 1.0
        wanted = {name: _number(name, goal) * scale for name, goal in goals.items()}
        if time is None:
            rows = self._connection.call("GetStatus", joints=True)["joints"]
            time = slow_duration(wanted, goals_of(rows))
        self._connection.require_unstopped(stops)
        return self.follow(list(wanted), [list(wanted.values())], [time], retime=retime)

    def approach(self, goals: Mapping[str, float]) -> MotionOutcome:
        """Move slowly to goals (rad), those beyond a limit to the limit. Raises as `move`."""
        limits = self.limits
        anywhere = (-inf, inf)  # of a joint that the gate refuses by name
        bounds = {name: limits.get(name, anywhere) for name in goals}
        inside = {name: min(max(goal, bounds[name][0]), bounds[name][1]) for name, goal in goals.items()}
        return self.move(inside, retime=True)

    def pose(self, name: str, *, time: float | None = None, retime: bool = False) -> MotionOutcome:
        """Move to a pose of the robot file. Raises InvalidInput: there is no such pose; else as `move`."""
        if name not in self.poses:
            raise InvalidInput(f"no pose {name!r}; there are {', '.join(self.poses)}")
        goals = dict.fromkeys(self.names, 0.0) | dict(self.poses[name])
        return self.move(goals, time=time, retime=retime)

    def follow(
        self,
        joints: Sequence[str],
        positions: ArrayLike,
        times: ArrayLike,
        *,
        degrees: bool = False,
        retime: bool = False,
    ) -> MotionOutcome:
        """Follow points (k, n) at times (k,), s from the start, at rest at the last; return at its end.

        A smooth path leads through the points. Raises InvalidInput: shapes that do not fit; else as `move`.
        """
        rows = np.array(positions, np.float64) * (radians(1.0) if degrees else 1.0)
        stamps = np.array(times, np.float64)
        if rows.ndim != 2 or rows.shape != (len(stamps), len(joints)):
            raise InvalidInput(
                f"follow: positions have the shape {rows.shape}; {len(stamps)} times and {len(joints)} "
                f"joints need {(len(stamps), len(joints))}"
            )
        velocities = np.zeros_like(rows)
        if len(rows) > 2:
            velocities[:-1] = np.gradient(rows, stamps, axis=0)[:-1]
        elif len(rows) == 2:
            velocities[0] = (rows[1] - rows[0]) / (stamps[1] - stamps[0])
        points = [
            {"positions": at.tolist(), "velocities": speed.tolist(), "time_from_start": float(stamp)}
            for at, speed, stamp in zip(rows, velocities, stamps, strict=True)
        ]
        return self.submit({"joint_names": list(joints), "points": points}, retime=retime)

    def play(self, motion: str, *, retime: bool = False) -> MotionOutcome:
        """Play a motion of the robot by its name, or a trajectory file by its path; return at its end.

        Raises InvalidInput: there is no such motion; else as `move`.
        """
        folder = self._description.get("motions")
        try:
            trajectory = load_motion(motion, None if folder is None else Path(folder), self.names)
        except (UsageError, Rejected) as error:
            raise InvalidInput(str(error)) from None
        return self.submit(trajectory, retime=retime)

    def submit(self, trajectory: Mapping[str, Any], *, retime: bool = False) -> MotionOutcome:
        """Run a `Trajectory` of the interface to its end. KeyboardInterrupt stops it. Raises as `move`."""
        given = {**trajectory, "policy": "retime"} if retime else dict(trajectory)
        return self._connection.run(given, self._connection.stops)

    def stop(self) -> None:
        """Decelerate and hold, at once and from any thread; a motion that is about to begin does not.

        A motion under way, and a stream at its next `send`, raise MotionFailed. Raises ClientError.
        """
        self._connection.note_stop()
        with Client(self._socket, timeout=STOP) as client:  # answered, in case that connection was lost
            client.call("Cancel")

    def stream(
        self,
        joints: Sequence[str] | None = None,
        *,
        rate: float = 100.0,
        degrees: bool = False,
        clamp: bool = False,
        strict: bool = True,
    ) -> GoalStream:
        """Return a stream of goals for joints (None: all), to be used as a context.

        with robot.stream(["head_yaw"], rate=100) as stream:
            for t in stream:
                stream.send({"head_yaw": 0.3 * sin(t)})

        `clamp`: goals beyond a limit are clipped and reported, instead of refused. `strict`: a refusal is
        raised by the next `send`; else it is counted in `report`. Raises InvalidInput: a joint that the
        robot does not have.
        """
        named = self.names if joints is None else tuple(joints)
        known = {each["name"]: each for each in self._description["joints"]}
        unknown = [name for name in named if name not in known]
        if unknown:
            raise InvalidInput(f"no joint {unknown[0]}; there are {', '.join(known)}")
        limits = np.array([known[name]["velocity_limit"] for name in named], np.float64)
        scale = radians(1.0) if degrees else 1.0
        send = partial(self._connection.setpoint, self._connection.stops)
        return GoalStream(send, named, limits, rate, scale=scale, clamp=clamp, strict=strict)

    def walk(
        self,
        forward: float = 0.0,
        left: float = 0.0,
        turn: float = 0.0,
        *,
        seconds: float | None = None,
        command: "Callable[[float], tuple[float, float, float] | None] | None" = None,
    ) -> "WalkOutcome":
        """Walk at a velocity (m/s, m/s, rad/s) for `seconds`, stop, and return when the robot stands.

        `command`: seconds since the start to a velocity, None to stop, instead of one velocity. For an armed
        robot of two six-joint legs on its own feet; needs the extra `walk`. Ctrl-C ends the goals: it
        holds as it stands. Raises InvalidInput: too fast, not armed, or such a robot it is not; MotionFailed:
        it fell; else as `move`.
        """
        from twind.robot_client.walk_run import run_walk  # noqa: PLC0415 - mink is no other call's
        from twind.walk.walking_engine import WalkingEngine  # noqa: PLC0415

        if command is None and seconds is None:
            raise InvalidInput("walk: give `seconds` or `command`")
        require_armed(self.status)
        engine = WalkingEngine(robot_file_of(self._connection.call("GetRobot")))
        return run_walk(self, engine, command or (lambda _: (forward, left, turn)), seconds)

    def _repr_html_(self) -> str:
        """Return the table of the newest state that a notebook shows."""
        return self.state.to_html()

    def __repr__(self) -> str:
        return f"<twind.Robot {self.name} at {self._connection.client.path}>"


def _number(joint: str, goal: float) -> float:
    """Return the goal of a joint. Raises InvalidInput: it is no number."""
    try:
        return float(goal)
    except (TypeError, ValueError):
        raise InvalidInput(f"move: {joint}: {goal!r} is no number") from None


def _is_armed(status: Mapping[str, Any]) -> bool:
    """Return whether this `Status` is of a robot with torque that takes motions."""
    return bool(status["armed"]) and status["state"] == RobotState.ARMED
