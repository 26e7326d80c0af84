"""Key space of robots over Zenoh. JSON everywhere, the objects of `io.twind.Control`.

twind/ROBOT/alive          liveliness token: its uplink is up
twind/ROBOT/alive/SESSION  the same, of each session: by it two of one name detect each other
twind/ROBOT/state/RATE     Monitor's messages of the topic state, so many a second (full: all)
twind/ROBOT/news/TOPIC     Monitor's messages of the other topics
twind/ROBOT/ask/METHOD     query -> answer; reading methods, for every observer
twind/ROBOT/check          query -> Check's answer, for operators: the check of a goal
twind/ROBOT/stop/METHOD    query -> answer; Cancel and EStop: no lease, never refused here
twind/ROBOT/lease          query {"op": acquire, "holder", "take"?, "deadline"?} -> Grant
                           or {"op": renew|release, "lease"} -> Grant
twind/ROBOT/goal           query {"goal", "lease", "deadline", "trajectory"} -> {"id", "phase", "progress", …}
twind/ROBOT/goals/GOAL     its progress: answers of SubmitTrajectory, {"phase", "progress", …}

Parameters and answers are JSON objects in the payload; an error is an error reply {"error", "parameters"}.
`deadline` is in the robot's own clock, which each Grant reports (`now`): clocks of machines may differ.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

ROOT = "twind"
RATES = ("1", "10", "30", "full")  # Hz
TOPICS = ("status", "latency", "events", "verdicts", "trajectories", "stream")
ASKED = ("GetStatus", "GetRobot", "GetParameters")
STOPS = ("Cancel", "EStop")
LEASE_S = 1.0  # s after which a remote lease lapses without a renewal
LONGEST = 64  # characters of a name
_NAME = re.compile(rf"[A-Za-z0-9_.-]{{1,{LONGEST}}}")


def robot_key(robot: str, *parts: str) -> str:
    """Return `twind/ROBOT/PARTS...`. Raises ValueError: a name that is no single chunk of a key."""
    return "/".join((ROOT, chunk("robot", robot), *parts))


def chunk(what: str, name: str) -> str:
    """Return `name`, if it can be one chunk of a key. Raises ValueError."""
    if _NAME.fullmatch(name) is None or name.startswith("."):
        raise ValueError(
            f"{what} {name[:80]!r}: must be 1 to {LONGEST} of A-Z a-z 0-9 _ . -, and not begin with a dot"
        )
    return name


def robot_name(status: Mapping[str, object], parameters: Mapping[str, object]) -> str:
    """The individual's name, else the robot file's, as one chunk of a key: other characters become `-`.

    `status`: of GetStatus; `parameters`: of GetParameters.
    """
    name = str(parameters.get("individual") or status["robot"])
    return re.sub(r"[^A-Za-z0-9_.-]", "-", name).lstrip(".")[:LONGEST] or "robot"


def robot_of(key: str) -> str:
    """Return the robot's name in a key. Raises ValueError: not a key of twind, or an invalid name."""
    parts = key.split("/")
    if len(parts) < 3 or parts[0] != ROOT:
        raise ValueError(f"key {key[:80]!r} is none of twind's")
    return chunk("robot", parts[1])
