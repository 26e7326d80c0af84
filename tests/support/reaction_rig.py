"""Findings injected into the guard, and the raised arm that reactions lower."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from tests.support.daemon_rig import Rig
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Motion
from twind_drivers.dynamixel.damping import SHARE
from twind_drivers.half_duplex.soft_gain import SOFT

WHY = (Finding(ReasonCode.FOLLOW_ERR, 3, value=0.6, bound=0.5, message="rad: ordered by the test"),)
# of the h24
P = 1600
PWM = 885


@contextmanager
def injected_findings(rig: Rig, **more: Any) -> Iterator[None]:
    """While inside, the guard says this besides what it finds."""
    guard = rig.loop.parts.guard
    judge = guard.judge

    def also(facts: Any) -> Any:
        return replace(judge(facts), **{"findings": WHY, "causes": WHY, **more})

    guard.judge = also  # type: ignore[method-assign]
    try:
        yield
    finally:
        guard.judge = judge  # type: ignore[method-assign]


def raised(rig: Rig) -> None:
    """An arm goes up, and the robot holds it there."""
    ticket = rig.submit(rig.path("l_shoulder_pitch", [-1.5], [1.5]), more=True)
    rig.seconds(1.8)
    assert rig.replies(ticket)[0].error is None
    assert rig.loop.executor.motion is Motion.HOLDING
    rig.lease()  # it has lapsed meanwhile


def soft(rig: Rig) -> bool:
    return bool(
        (rig.register("goal_pwm") == int(SHARE * PWM)).all()
        and (rig.register("position_p_gain") == P // SOFT).all()
        and (rig.register("position_d_gain") == P).all()
    )
