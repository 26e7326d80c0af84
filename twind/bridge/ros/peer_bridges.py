"""Peer bridges that take commands under the same names: one message would move two robots. Library, 3.10.

Each bridge reads the topic /bridge/status of its namespace, which every bridge with the same names writes.
No query is sent and the graph is not inspected, so it is the same on every back end.
"""

from __future__ import annotations

import json
import threading
import time
import uuid
from collections.abc import Callable

from twind.ros import STRING, decode

SILENT = 5.0  # s without a status after which a bridge is gone; each sends one twice a second
MOST = 16  # that are kept
LONGEST = 1 << 20  # bytes of a status


class PeerBridges:
    """Any thread may call any method. `id`: that of this bridge, as `bridge.id` in its own status."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Start without peers; `now`: s, monotonic."""
        self.id = uuid.uuid4().hex[:8]
        self._now = now
        self._lock = threading.Lock()
        self._others: dict[str, tuple[str, float]] = {}  # by id: the robot's name, time of its status (s)

    def on_bridge_status(self, data: bytes) -> None:
        """Take a String of /bridge/status from any bridge. An invalid one is ignored."""
        try:
            status = json.loads(decode(STRING, data)["data"]) if len(data) <= LONGEST else {}
            bridge = status["bridge"]
            name = str(bridge.get("id"))[:64]
            robot = str(status.get("robot") or "unknown")[:64]
            takes = bool(bridge.get("commands"))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return
        with self._lock:
            self._others.pop(name, None)
            if takes and name != self.id:
                while len(self._others) >= MOST:
                    del self._others[next(iter(self._others))]
                self._others[name] = robot, self._now()

    def conflict_text(self) -> str:
        """Return which other bridges take commands here, and the remedy; "": none."""
        since = self._now() - SILENT
        with self._lock:
            known = [f"{robot} (bridge {name})" for name, (robot, at) in self._others.items() if at > since]
        if not known:
            return ""
        return (
            f"another bridge takes commands under these names: {', '.join(sorted(known))}. One message would "
            "move both, so only stops are done: give each robot a namespace (--ros-args -r __ns:=/NAME) or a "
            "ROS_DOMAIN_ID, or all but one --no-commands"
        )
