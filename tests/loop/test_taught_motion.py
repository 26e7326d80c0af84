"""A hand guides limp virtual servos, and the taught motion is played as the hand guided it. Fake clock."""

from math import pi, sin

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.doc_pages_text import ROOT
from twind import link
from twind.ctl.offline_check import verdict
from twind.ctl.teaching.hand_recorder import HandRecorder
from twind.ctl.teaching.taught_motion import TaughtMotion, passed_by_gate, taught_motion
from twind.front.joint_naming import JointNames
from twind.front.trajectory_submission import judge, message_of
from twind.robot.arrays import Floats
from twind.robot.trajectory import Trajectory

ARM = str(ROOT / "docs" / "examples" / "arm" / "arm.yaml")
START = {"shoulder_pitch": -0.2, "shoulder_roll": 0.1, "elbow": -0.4}  # rad
CLOSE = 0.02  # rad
LAG = 0.1  # s, the longest constant delay that is taken out of the measured path


def guide(rig: Rig, reach: dict[str, float], seconds: float) -> HandRecorder:
    """Record while a hand takes all joints to `reach` and back; it rests before and after."""
    recorder = HandRecorder(rig.names, rig.loop.robot.period)
    for tick in range(round((seconds + 0.6) / 0.01)):
        phase = min(1.0, max(0.0, 0.01 * tick - 0.3) / seconds)
        share = sin(pi * phase) ** 2
        pose = {name: START[name] + share * (reach[name] - START[name]) for name in START}
        rig.virtual["main"].faults.hand(pose=pose, speed=3.0)
        rig.ticks(1)
        recorder.take(state(rig))
    rig.virtual["main"].faults.hand(off=True)
    assert not recorder.ended
    return recorder


def state(rig: Rig) -> dict[str, object]:
    """The newest reading, as topic `state` has it."""
    tick = next(news for news in reversed(rig.news) if isinstance(news, link.Tick))
    columns = zip(rig.names, np.frombuffer(tick.position).tolist(), tick.heard, strict=True)
    rows = [
        {"name": name, "position": at, "heard": heard != 0, "torque": False} for name, at, heard in columns
    ]
    return {"time": tick.time, "mode": tick.mode, "joints": rows}


def played(rig: Rig, motion: TaughtMotion) -> tuple[Floats, Floats, Floats]:
    """Times from the motion's start, commanded and measured positions (k, n), while it is played."""
    path, wrong = judge(message_of(motion.trajectory()), JointNames(rig.names))
    assert path is not None, wrong
    approach = Trajectory(np.array([2.0]), path.position[:1], path.commanded, np.zeros((1, len(rig.names))))
    rows = []
    for each in (approach, path):
        first = len(rig.news)
        rig.lease()
        ticket = rig.submit(each, more=True)
        rig.seconds(float(each.time[-1]) + 0.5)
        last = rig.replies(ticket)[-1]
        assert (last.parameters or {}).get("phase") == "succeeded", last
        rows = [news for news in rig.news[first:] if isinstance(news, link.Tick)]
    goal, position = (
        np.array([np.frombuffer(getattr(row, key)) for row in rows]) for key in ("goal", "position")
    )
    return np.array([row.time for row in rows]), goal, position


def furthest(motion: TaughtMotion, time: Floats, path: Floats) -> tuple[float, float]:
    """Largest distance from the hand's path at equal phase, and the delay (s) that suits best, of all to LAG.

    The hand's samples are taken at the times that the motion gives them.
    """
    asked = motion.path.time - motion.path.time[0] + motion.lead - motion.points.time[0]
    found = []
    for lag in np.arange(0.0, LAG, 0.001):
        at = time[0] + asked + lag
        seen = np.array([np.interp(at, time, column) for column in path.T]).T
        found.append((float(np.abs(seen - motion.hand.position).max()), float(lag)))
    return min(found)


@pytest.mark.parametrize(
    ("seconds", "slowed"), [(4.0, False), (0.8, True)], ids=["within the limits", "faster than them"]
)
def test_a_taught_motion_is_played_as_the_hand_guided_it(
    make_rig: MakeRig, seconds: float, slowed: bool
) -> None:
    rig = make_rig(ARM, start=START)
    rig.connect()
    recorder = guide(rig, {"shoulder_pitch": -1.0, "shoulder_roll": 0.6, "elbow": -1.3}, seconds)
    hand = recorder.path()
    assert hand is not None
    here = rig.loop.robot.measured.position
    taught = taught_motion(tuple(rig.names), hand, 0.01, 1.0)
    motion, judged = passed_by_gate(taught, lambda sent: verdict(rig.one.binding, here, sent))
    assert not judged["refusals"]
    assert (motion.added > 0.0) is slowed
    assert len(motion.points.time) <= 20

    rig.arm()
    time, commanded, measured = played(rig, motion)
    intended = furthest(motion, time, commanded)
    seen = furthest(motion, time, measured)
    print(f"commanded {intended[0]:.4f} rad, measured {seen[0]:.4f} rad after {seen[1]:.3f} s")
    assert intended[0] <= CLOSE
    assert seen[0] <= CLOSE
