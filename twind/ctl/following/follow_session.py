"""`twindctl follow`: goals from the readings of a leader, as long as these are fresh."""

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from twind.client import ClientError, NoAnswer
from twind.command_line.verb import REFUSED, UsageError
from twind.ctl.following.joint_mapping import STALE, JointLink, link_joints, stale_reading
from twind.exceptions import InvalidInput
from twind.protocol.socket_paths import SYSTEM
from twind.robot_client.goal_stream import GoalStream
from twind.robot_client.robot import Robot
from twind.robot_client.snapshot import RobotSnapshot

T = TypeVar("T")
TOLD = 1.0  # s between two lines on what the gate changed or refused


def follow(options: argparse.Namespace) -> int:
    """Follow until the leader is lost. Raises UsageError, ClientError."""
    with (
        Robot(place_of(options.leader), read_only=True, state_rate=options.rate) as leader,
        Robot(place_of(options.follower), take=options.take) as follower,
    ):
        try:
            links = link_joints(
                leader.names,
                follower.names,
                _pairs("--map", options.map, str),
                _pairs("--scale", options.scale, float),
                _pairs("--offset", options.offset, float),
            )
            stream = follower.stream(
                [each.follower for each in links], rate=options.rate, clamp=True, strict=False
            )
        except InvalidInput as error:
            raise UsageError(str(error)) from None
        why = _stale(links, leader.state)
        if not why:
            _print("moving slowly to the leader's pose")
            start = leader.state
            follower.approach({each.follower: each.goal(_position(start, each)) for each in links})
            _print(f"following {len(links)} joints; Ctrl-C ends it")
            why = _run(leader, links, stream)
    _print(f"ended, the follower holds: {why}")
    return REFUSED


def place_of(name: str) -> str:
    """Return the folder of a robot's sockets: a path, or the instance of that name."""
    return name if os.sep in name or Path(name).is_dir() else os.path.join(SYSTEM, name)


def _run(leader: Robot, links: Sequence[JointLink], stream: GoalStream) -> str:
    """Send goals; return why they ended. Leaving the stream lets the last goal run out."""
    report = FollowReport(stream)
    before: RobotSnapshot | None = None
    with stream:
        try:
            states = leader.states(patience=STALE)
            while True:
                try:
                    snapshot = next(states)
                except ClientError as error:  # of the leader; those of the follower are not its loss
                    return str(error)
                if why := _stale(links, snapshot):
                    return why
                goals = [each.goal(_position(snapshot, each)) for each in links]
                if before is None or snapshot.stamp <= before.stamp:
                    speeds = [0.0] * len(links)
                else:
                    span = snapshot.stamp - before.stamp
                    speeds = [
                        (goal - each.goal(_position(before, each))) / span
                        for goal, each in zip(goals, links, strict=True)
                    ]
                stream.send(goals, speeds)
                report.tell(time.monotonic())
                before = snapshot
        except NoAnswer as error:
            return str(error)


def _stale(links: Sequence[JointLink], snapshot: RobotSnapshot) -> str | None:
    message = snapshot.message
    positions = dict(zip(snapshot.names, message.position.tolist(), strict=True))
    ages = dict(zip(snapshot.names, message.age.tolist(), strict=True))
    return stale_reading(links, time.monotonic() - message.time, positions, ages)


def _position(snapshot: RobotSnapshot, link: JointLink) -> float:
    return float(snapshot.position[snapshot.names.index(link.leader)])


def _pairs(option: str, given: Sequence[str], kind: Callable[[str], T]) -> dict[str, T]:
    """Return NAME=VALUE options. Raises UsageError."""
    pairs: dict[str, T] = {}
    for text in given:
        name, equals, value = text.partition("=")
        try:
            pairs[name] = kind(value)
        except ValueError:
            equals = ""
        if not name or not equals or not value:
            raise UsageError(f"{option} {text!r}: expected NAME=VALUE")
    return pairs


class FollowReport:
    """Prints once a second which goals the gate changed or refused."""

    def __init__(self, stream: GoalStream) -> None:
        self._stream = stream
        self._at = 0.0
        self._refused = 0

    def tell(self, now: float) -> None:
        """Print what is new at `now`, s."""
        if now - self._at < TOLD:
            return
        self._at = now
        report = self._stream.report
        changed: Counter[str] = Counter()
        while report.changes:  # another thread appends
            each = report.changes.popleft()
            changed[f"{each['code']} {each['joint']}"] += 1
        if changed:
            _print("; ".join(f"{what}: {count} goals clipped" for what, count in changed.items()))
        if report.refused > self._refused:
            _print(f"{report.refused - self._refused} goals refused: {report.refusal}")
        self._refused = report.refused


def _print(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
