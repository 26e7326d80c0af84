"""Jog under a held control of the page: setpoints with the lease of a tab, while its dead-man hold lasts.

Runs in the thread that holds the lease. Setpoints end within a period of the hold, then the motion is
cancelled: it decelerates and holds. If this process hangs or dies, they end as well.
"""

import contextlib
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from twind.client import CallError, Client, ClientError
from twind.client.move_duration import present_goals
from twind.ctl.reasons.refusal_text import refusal_text
from twind.exceptions import InvalidInput
from twind.observe.viewing.dead_man_hold import DeadManHold, HoldPhase, Press
from twind.observe.viewing.stop_threads import StopOutcome
from twind.robot_client.goal_stream import GoalStream
from twind.robot_client.held_jog import ANSWER, PERIOD, follow_while_held
from twind.robot_client.jog_motion import HOLD, SLIDER, JogMotion, JogRequest, plan_jog

SETTLED = 0.1  # s that the last setpoint of a way is repeated: a joint lags a little
# the page shows it unless the control was released
LAPSED = StopOutcome(False, "lapsed", f"the page did not answer within {HOLD:g} s. Remedy: press again")

Work = Callable[[Client], StopOutcome]


def jog(robot: Mapping[str, Any], request: JogRequest, hold: DeadManHold, press: Press) -> Work:
    """Return the work that moves `robot` (as in the answer of `GetRobot`) while `press` is held."""

    def work(client: Client) -> StopOutcome:
        control = _HeldControl(request, hold, press)
        try:
            with client.within(ANSWER):
                motion = plan_jog(request, robot, present_goals(client))
                if control.is_begun():
                    stream = GoalStream(
                        partial(client.call, "Setpoint"), motion.names, motion.speed, 1.0 / PERIOD
                    )
                    follow_while_held(stream, motion, control.steer)
                    with contextlib.suppress(ClientError):
                        client.call("Cancel")
        except InvalidInput as error:
            return StopOutcome(False, "not moved", str(error))
        except CallError as error:  # perhaps another client moves the robot now: no Cancel
            return StopOutcome(False, *refusal_text(error))
        return StopOutcome(True, "there", "") if control.is_there else LAPSED

    return work


class _HeldControl:
    """One press of a control, and whether its motion has arrived."""

    def __init__(self, request: JogRequest, hold: DeadManHold, press: Press) -> None:
        self.is_there = False
        self._request = request
        self._hold = hold
        self._press = press
        self._done_at: float | None = None  # s, when the last setpoint of the way was sent

    def is_begun(self) -> bool:
        """Wait until the page has returned a token; False: it did not in time, or it was released."""
        while (phase := self._hold.phase(self._press, time.monotonic())) is HoldPhase.PRESSED:
            time.sleep(0.25 * PERIOD)
        return phase is HoldPhase.HELD

    def steer(self, motion: JogMotion, now: float) -> bool:
        """Direct the motion to where a slider is. False: no longer held, or a button's way has ended."""
        if self._hold.phase(self._press, now) is not HoldPhase.HELD:
            return False
        if self._request.kind == SLIDER:
            motion.target[:] = self._request.value
        elif motion.is_done:
            self._done_at = now if self._done_at is None else self._done_at
            self.is_there = now - self._done_at > SETTLED
        return not self.is_there
