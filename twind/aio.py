"""`twind.aio.Robot`: the same robot for asyncio. Each call runs in a thread of its own."""

import asyncio
import os
from collections.abc import AsyncIterator, Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

from numpy.typing import ArrayLike

from twind.client import ClientError
from twind.robot_client.goal_stream import Goals, GoalStream, StreamReport
from twind.robot_client.motion_outcome import MotionOutcome
from twind.robot_client.robot import Robot as BlockingRobot
from twind.robot_client.snapshot import JointReading, RobotSnapshot

P = ParamSpec("P")
T = TypeVar("T")


class AsyncRobot:
    """`twind.Robot` whose methods are awaited. `async with` connects; arguments and errors are the same.

    A cancelled await of a motion stops the robot, as `stop` does.
    """

    def __init__(self, socket: str | os.PathLike[str] | None = None, **options: Any) -> None:
        self._make = lambda: BlockingRobot(socket, **options)
        self._stopper = ThreadPoolExecutor(1, "stop")  # never behind a motion
        self._robot: BlockingRobot | None = None

    async def __aenter__(self) -> "AsyncRobot":
        self._robot = await asyncio.to_thread(self._make)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await asyncio.to_thread(self.blocking.__exit__, kind, error, trace)

    @property
    def blocking(self) -> BlockingRobot:
        """The robot behind it. Raises RuntimeError outside `async with`."""
        if self._robot is None:
            raise RuntimeError("use it as `async with Robot() as robot`")
        return self._robot

    async def state(self) -> RobotSnapshot:
        """The newest state."""
        return await asyncio.to_thread(lambda: self.blocking.state)

    async def joints(self) -> Mapping[str, JointReading]:
        """The newest state by joint."""
        return (await self.state()).joints

    async def arm(self, *, limp: Collection[str] = ()) -> None:
        """`Robot.arm`."""
        await asyncio.to_thread(self.blocking.arm, limp=limp)

    async def disarm(self) -> None:
        """`Robot.disarm`."""
        await asyncio.to_thread(self.blocking.disarm)

    async def estop(self, *, cut: bool = False, reason: str = "") -> None:
        """`Robot.estop`."""
        robot = self.blocking
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(self._stopper, lambda: robot.estop(cut=cut, reason=reason))

    async def reset(self) -> None:
        """`Robot.reset`."""
        await asyncio.to_thread(self.blocking.reset)

    async def move(self, goals: Mapping[str, float], **options: Any) -> MotionOutcome:
        """`Robot.move`."""
        return await self._moving(self.blocking.move, goals, **options)

    async def pose(self, name: str, **options: Any) -> MotionOutcome:
        """`Robot.pose`."""
        return await self._moving(self.blocking.pose, name, **options)

    async def follow(
        self, joints: Sequence[str], positions: ArrayLike, times: ArrayLike, **options: Any
    ) -> MotionOutcome:
        """`Robot.follow`."""
        return await self._moving(self.blocking.follow, joints, positions, times, **options)

    async def play(self, motion: str, **options: Any) -> MotionOutcome:
        """`Robot.play`."""
        return await self._moving(self.blocking.play, motion, **options)

    async def stop(self) -> None:
        """`Robot.stop`."""
        await asyncio.get_running_loop().run_in_executor(self._stopper, self.blocking.stop)

    def stream(self, joints: Sequence[str] | None = None, **options: Any) -> "AsyncGoalStream":
        """`Robot.stream`, for `async with` and `async for`."""
        return AsyncGoalStream(self.blocking.stream(joints, **options))

    async def _moving(self, method: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return await asyncio.to_thread(method, *args, **kwargs)
        except asyncio.CancelledError:
            with suppress(ClientError):
                await asyncio.shield(self.stop())
            raise


Robot = AsyncRobot


class AsyncGoalStream:
    """`GoalStream` for asyncio."""

    def __init__(self, stream: GoalStream) -> None:
        self._stream = stream

    @property
    def report(self) -> StreamReport:
        """Fate of the goals so far."""
        return self._stream.report

    async def __aenter__(self) -> "AsyncGoalStream":
        self._stream.__enter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await asyncio.to_thread(self._stream.__exit__, kind, error, trace)

    async def __aiter__(self) -> AsyncIterator[float]:
        periods = iter(self._stream)
        while True:
            yield await asyncio.to_thread(next, periods)

    def send(self, goals: Goals, velocities: Goals | None = None) -> None:
        """`GoalStream.send`: it does not wait."""
        self._stream.send(goals, velocities)
