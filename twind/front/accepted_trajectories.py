"""Trajectories that wait for the loop's verdict, and their result: topic `trajectories`. Front process.

The loop reports its changes only, not the path again, which has up to 2,000 points. The functions that the
gate used (`safety/retime.py`) compute the changed path here, so both sides have the same numbers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twind.front.joint_naming import JointNames, Plain
from twind.link import VerdictReport
from twind.robot.finding import Finding, ReasonCode
from twind.robot.trajectory import Trajectory
from twind.safety import retime

WAITING = 64  # paths that may wait for their verdict; the loop answers every one, or has broken
COLUMNS = ("positions", "velocities", "accelerations")
ASKED = ("start_in", "goal_time", "tolerances")  # what a trajectory has beside its points, and keeps


@dataclass(frozen=True, slots=True, eq=False)
class AcceptedTrajectory:
    """Accepted path with its result. `asked`: the fields of the request beside its points (`kept`)."""

    id: str
    holder: str
    path: Trajectory
    asked: Mapping[str, object]

    def plain(self, names: JointNames) -> Plain:
        """Return it as `Accepted` of the interface.

        Requested changes are already made in its points, so it does not request them again.
        """
        path = self.path
        joints = np.flatnonzero(self.path.commanded)
        given = zip(COLUMNS, (path.position, path.velocity, path.acceleration), strict=True)
        rows = {key: column[:, joints].tolist() for key, column in given if column is not None}
        points = [
            {"time_from_start": time} | {key: row[place] for key, row in rows.items()}
            for place, time in enumerate(path.time.tolist())
        ]
        trajectory = {"joint_names": [names.joints[joint] for joint in joints], "points": points}
        return {"id": self.id, "holder": self.holder, "trajectory": {**trajectory, **self.asked}}


def strip_points(message: Mapping[str, Any]) -> Plain:
    """Return the fields of an interface `Trajectory` that are kept.

    Its points are left out: they are megabytes, and the path already has them.
    """
    return {key: message.get(key) for key in ASKED}


class PendingVerdict:
    """Trajectories that were sent to the loop and have no verdict yet."""

    def __init__(self) -> None:
        self.waiting: dict[str, AcceptedTrajectory] = {}

    def wait(self, sent: AcceptedTrajectory) -> None:
        """Store a sent trajectory until its verdict comes. The oldest is dropped where too many wait."""
        self.waiting[sent.id] = sent
        if len(self.waiting) > WAITING:
            del self.waiting[next(iter(self.waiting))]

    def resolve(self, moment: VerdictReport) -> AcceptedTrajectory | None:
        """Return the trajectory that this verdict lets the loop follow, with its changes; None: none."""
        sent = self.waiting.pop(moment.id, None)
        if sent is None or moment.verdict.get("refusals"):
            return None
        changes = [
            Finding(ReasonCode(each["code"]), value=each["value"])
            for each in moment.verdict.get("changes") or ()
        ]
        path = retime.changed(sent.path, changes)
        return replace(sent, path=replace(path, time=path.time + moment.lead))
