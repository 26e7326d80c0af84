"""Queue of commands from ROS for the daemon: bounded under any load. Standard library, Python 3.10.

Of commands for the same joints that begin at once the newest goes first. If it is accepted, the older ones
are dropped, since the daemon would follow only it. If it is refused, they stay valid.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

from twind.bridge.ros.ros_trajectory import CommandHeader

ROOM = 8  # commands that wait; one more, and the oldest goes
PACE = 1.0 / 15.0  # s between two that are taken: the daemon refuses more than 20 a second
TELL = 1.0  # s between two words on commands that were dropped

Report = Callable[[Mapping[str, Any]], None]


@dataclass(eq=False, slots=True)
class RosCommand:
    """One trajectory requested over ROS."""

    data: bytes  # CDR of a JointTrajectory; none once it was read
    head: CommandHeader | None  # None: malformed
    came: float  # s, monotonic
    report: Report | None = (
        None  # receiver of its reports; a command with one is never dropped for a newer one
    )
    more: Mapping[str, Any] = field(default_factory=dict)  # goal_time, tolerances, as the daemon takes them
    cancelled: bool = False
    began: float = inf  # s, monotonic, when it was accepted; inf: it is not under way
    number: int = 0  # in the order in which they came


class RosCommandQueue:
    """Queue of commands.

    `put` and `wake` may be called from any thread and return at once; all else from one.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._waiting: list[RosCommand] = []
        self._changed = threading.Condition()
        self._woken = False
        self._next = self._tell_at = -inf  # s, earliest next command, and report of drops
        self._count = self._dropped = 0
        self._last = CommandHeader()

    def put(self, command: RosCommand) -> list[RosCommand]:
        """Queue a command. Return the commands dropped for lack of room whose senders wait for a report."""
        with self._changed:
            self._count += 1
            command.number = self._count
            self._waiting.append(command)
            over = self._waiting[: max(0, len(self._waiting) - ROOM)]
            self._drop(over)
            if len(self._waiting) == 1:  # no use in being woken by each of a flood
                self._changed.notify()
        return [each for each in over if each.report is not None]

    def accepted(self, command: RosCommand) -> None:
        """Drop the waiting commands that `command`, now accepted, makes void."""
        with self._changed:
            self._drop([each for each in self._waiting if _voids(command, each)])

    def wake(self) -> None:
        """Let `take` return."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def take(self, patience: float) -> RosCommand | None:
        """Return the oldest command, or one that would make it void, when it is time.

        None after `patience` s, or when woken.
        """
        with self._changed:
            early = self._next - self._now()
            if early > 0.0:
                self._changed.wait_for(lambda: self._woken, min(early, patience))
                if self._woken or early > patience:
                    self._woken = False
                    return None
            self._changed.wait_for(lambda: self._waiting or self._woken, patience)
            self._woken = False
            command = self._waiting[0] if self._waiting else None
            for newer in self._waiting:
                command = newer if command is not None and _voids(newer, command) else command
            if command is not None:
                self._waiting.remove(command)
        if command is not None:
            self._next = self._now() + PACE
        return command

    def dropped(self) -> tuple[int, CommandHeader] | None:
        """Return count and last of the commands dropped since the last report; None: no report now."""
        now = self._now()
        with self._changed:
            if not self._dropped or now < self._tell_at:
                return None
            count = self._dropped
            self._dropped = 0
            self._tell_at = now + TELL
            return count, self._last

    def _drop(self, commands: Sequence[RosCommand]) -> None:
        """Drop these commands. The caller holds the lock."""
        for gone in commands:
            self._waiting.remove(gone)
            self._dropped = self._dropped + 1
            self._last = gone.head or CommandHeader()


def _voids(newer: RosCommand, older: RosCommand) -> bool:
    """Return True if following the newer command leaves nothing of the older."""
    new = newer.head
    old = older.head
    if new is None or old is None or older.report is not None or newer.number <= older.number:
        return False
    return new.time_ns == old.time_ns == 0 and set(new.joints) >= set(old.joints)
