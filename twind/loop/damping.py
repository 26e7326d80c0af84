"""DAMP procedure: torque stays and becomes soft, the goals follow the sinking robot, then torque goes off.

For a robot that cannot be lowered to its rest pose, or is falling already. The only way back is torque off
and arming anew: any procedure that takes the torque over continues to damp. Not verified on hardware.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from twind.loop.bus_port import ScriptRun
from twind.loop.procedures import Procedure
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding

if TYPE_CHECKING:
    from collections.abc import Sequence

    from twind.loop.tick import Loop

SINK = 0.5  # rad/s of the goals behind the joints: what falls faster, the stiffness that is left brakes
SLOW = 0.05  # rad/s: slower is at rest ...
# s ... for this long, or after this long at the latest: then torque off
SLOW_FOR = 1.0
SLOW_MOST = 5.0


def demand(loop: Loop, why: Sequence[Finding], now: float) -> None:
    """Allow only damping and torque off from now on; a motion to the rest pose under way ends."""
    if loop.soft_since is None:
        loop.soft_since = now
        because = f": {why[0].code}: {why[0].message}" if why else ""
        said = f"the robot is damped, then let go: support it{because}"
        loop.say.event("error", EventCode.DAMP, said, tuple(why), stop="damp")


def damp(loop: Loop) -> Procedure:
    """Damp until every joint has been at rest for a second, at the latest some seconds after the demand."""
    now = loop.clock.now()
    demand(loop, (), now)
    assert loop.soft_since is not None  # just demanded
    until = loop.soft_since + SLOW_MOST
    quiet_since = now
    tasks = loop.hardware.damp()
    told = False
    while now < until and now - quiet_since < SLOW_FOR:
        loop.executor.yield_to(loop.hardware.reachable(loop.measured.position), SINK)
        if not told and all(task.done for task in tasks):
            told = True
            _report_unconfirmed(loop, tasks)
        now = yield
        if not _quiet(loop):
            quiet_since = now


def _quiet(loop: Loop) -> bool:
    """True when every joint has a fresh reading and is slow."""
    heard = loop.measured.age <= SLOW_FOR
    return bool((heard & (np.abs(loop.measured.velocity) <= SLOW)).all())


def _report_unconfirmed(loop: Loop, tasks: Sequence[ScriptRun[tuple[int, ...]]]) -> None:
    """Report the devices that did not confirm damping, without a wait for them.

    An e-stop counts as begun once every device has confirmed.
    """
    stiff = [id for task in tasks for id in task.result or ()]
    loop.stops.begun |= not stiff and all(task.error is None for task in tasks)
    if stiff:
        loop.say.event("error", EventCode.DAMP, f"ids {stiff} did not confirm that they are damped")
    for task in tasks:
        if task.error is not None:
            loop.say.event("error", EventCode.DAMP, f"not damped: {task.error}")
