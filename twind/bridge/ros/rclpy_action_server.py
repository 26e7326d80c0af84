"""Action server of FollowJointTrajectory under rclpy: a goal is a command like any other, with a result.

It takes the path of `/cmd/joint_trajectory`: same lease, same gate, and the newer of both replaces the other.
Every goal is accepted first, then checked. One that the gate refuses is aborted with the reasons in
`error_string`, since a ROS rejection has no text. Standard library and rclpy; Python 3.10.
"""

from __future__ import annotations

import argparse
import importlib
import queue
import time
from collections.abc import Callable, Generator
from contextlib import closing, suppress
from typing import Any, Protocol

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

from twind.bridge.ros.action_goal_conversion import (
    SUCCESSFUL,
    GoalReport,
    State,
    as_bytes,
    outcome,
    places,
    seconds,
    tolerances,
    unserved,
)
from twind.bridge.ros.ros_names import relative
from twind.client import ClientError
from twind.client.clock_pair import SECOND, clocks
from twind.command_line.verb import observer

ACTION = "/cmd/follow_joint_trajectory"
KIND = "control_msgs/action/FollowJointTrajectory"
MOST = 4  # goals at once; the newest replaces the others, which end soon
UNDER_WAY = ("accepted", "running")  # every other phase is an end
RATE = 20.0  # Hz of feedback: `action_monitor_rate` of the usual controller
PATIENCE = 1.0  # s for a word of the daemon


class GoalConsumer(Protocol):
    """Receiver of trajectories: `RosCommands.goal`."""

    def __call__(
        self,
        data: bytes,
        report: Callable[[GoalReport], None],
        *,
        goal_time: float | None = None,
        tolerances: list[dict[str, Any]] | None = None,
    ) -> Callable[[], None]:
        """Submit the CDR of a JointTrajectory; return a function that cancels it.

        `report` receives phase, findings and message until the goal ends.
        """


class TrajectoryActionServer:
    """The action server of one node."""

    def __init__(self, node: Any, kind: Any, goals: GoalConsumer, sockets: str | None) -> None:
        self._kind = kind
        self._goals = goals
        self._sockets = sockets
        self._open: set[bytes] = set()  # ids of goals that have not ended
        self._closed = False
        self._server = ActionServer(
            node,
            kind,
            relative(ACTION),
            self._execute,
            goal_callback=self._accept_goal,
            handle_accepted_callback=self._accepted,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            # Of requests, one after the other, as `_open` needs; goals run beside them.
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    @classmethod
    def offered(
        cls, node: Any, goals: GoalConsumer, sockets: str | None, tell: Callable[[str], None]
    ) -> TrajectoryActionServer | None:
        """Create the server where the distribution has the action's type; else report what is missing."""
        package, folder, name = KIND.split("/")
        try:
            kind = getattr(importlib.import_module(f"{package}.{folder}"), name)
        except (ImportError, AttributeError) as error:
            tell(f"no action {ACTION}: {error}; install control-msgs of the distribution")
            return None
        return cls(node, kind, goals, sockets)

    def close(self) -> None:
        """Withdraw the goals that run, since no client could cancel them any more."""
        self._closed = True

    def destroy(self) -> None:
        """Destroy the server. Call after `close`, when no callback runs any more."""
        self._server.destroy()

    def _accept_goal(self, _: Any) -> Any:
        """More goals than threads would keep services waiting, an e-stop's too."""
        return GoalResponse.ACCEPT if len(self._open) < MOST else GoalResponse.REJECT

    def _accepted(self, handle: Any) -> None:
        self._open.add(bytes(handle.goal_id.uuid))
        handle.execute()

    def _execute(self, handle: Any) -> Any:
        """Run one goal to its end, in a thread of the executor."""
        try:
            return self._finish_goal(handle, self._followed(handle))
        finally:
            self._open.discard(bytes(handle.goal_id.uuid))

    def _followed(self, handle: Any) -> GoalReport:
        """Return the last report of a goal; until then send feedback and pass on its cancel."""
        beyond = unserved(handle.request)
        if beyond:
            return {"phase": "refused", "message": f"{beyond}: not served here; leave it empty"}
        reports: queue.SimpleQueue[GoalReport] = queue.SimpleQueue()
        goal = handle.request
        withdrawn = False
        cancel = self._goals(
            as_bytes(goal.trajectory),
            reports.put,
            goal_time=seconds(goal.goal_time_tolerance) or None,
            tolerances=tolerances(goal.path_tolerance, goal.goal_tolerance) or None,
        )
        with closing(states(self._sockets)) as following:
            for state in following:
                if not withdrawn and (handle.is_cancel_requested or self._closed):
                    withdrawn = True
                    cancel()
                while not reports.empty():
                    report = reports.get()
                    if report["phase"] not in UNDER_WAY:
                        return report
                if self._closed:
                    break
                if state is not None:
                    self._publish(handle, state)
        return {"phase": "lost", "message": "the bridge left the graph"}

    def _publish(self, handle: Any, state: State) -> None:
        names = list(handle.request.trajectory.joint_names)
        known = places(state, names)
        if known is None:
            return
        message = self._kind.Feedback()
        stamp = message.header.stamp  # of the reading, which may have waited
        stamp.sec, stamp.nanosec = divmod(clocks().wall(state["time"]), SECOND)
        message.joint_names = names
        message.desired.positions, message.actual.positions, message.error.positions = known
        with suppress(RuntimeError):  # the client, or the node, has just left
            handle.publish_feedback(message)

    def _finish_goal(self, handle: Any, last: GoalReport) -> Any:
        """Return the result, and set the state that goes with it."""
        result = self._kind.Result()
        result.error_code, result.error_string = outcome(last, asked=handle.is_cancel_requested)
        if result.error_code == SUCCESSFUL and last["phase"] == "succeeded":
            handle.succeed()
        elif last["phase"] == "cancelled" and handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        return result


def states(sockets: str | None) -> Generator[State | None, None, None]:
    """States at RATE, without end, on a connection of its own; None about as often where there are none."""
    while True:
        try:
            with closing(observer(argparse.Namespace(socket=sockets))) as client:
                client.timeout = PATIENCE
                yield from client.stream("Monitor", topics=["state"], rate=RATE)
        except ClientError:
            time.sleep(1.0 / RATE)
            yield None
