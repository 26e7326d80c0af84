"""Jog under a held button: setpoints with the lease of a tab, for as long as its dead-man hold lasts.

Runs in the thread that holds the lease. Setpoints end within `PERIOD` of the hold, then the motion is
cancelled: it decelerates and holds. If this process hangs or dies, they end as well.
"""

import contextlib
import time
from collections.abc import Callable, Mapping
from typing import Any

from twind.client import CallError, Client, ClientError
from twind.client.errors import Refused
from twind.client.move_duration import present_goals
from twind.ctl.reasons import remedy
from twind.exceptions import InvalidInput
from twind.observe.viewing.dead_man_hold import HOLD, DeadManHold, HoldPhase, Press
from twind.observe.viewing.jog_motion import JogMotion, JogRequest, plan_jog
from twind.observe.viewing.stop_threads import StopOutcome

PERIOD = 0.02  # s between setpoints
VALID = 0.1  # s that one may be followed without the next
SETTLED = 0.1  # s that the last setpoint of a way is repeated: a joint lags a little
# the page shows it unless the button was released
LAPSED = StopOutcome(False, "lapsed", f"the page did not answer within {HOLD:g} s. Remedy: press again")

Work = Callable[[Client], StopOutcome]


def jog(robot: Mapping[str, Any], request: JogRequest, hold: DeadManHold, press: Press) -> Work:
    """Return the work that moves `robot` (as in the answer of `GetRobot`) while `press` is held."""

    def work(client: Client) -> StopOutcome:
        try:
            motion = plan_jog(request, robot, present_goals(client))
            if not _is_begun(hold, press):
                return LAPSED
            return _follow(client, motion, hold, press)
        except InvalidInput as error:
            return StopOutcome(False, "not moved", str(error))
        except CallError as error:
            return StopOutcome(False, *refusal(error))

    return work


def refusal(error: CallError) -> tuple[str, str]:
    """Code of a refusal, and its message with the remedy."""
    findings = error.findings if isinstance(error, Refused) else ()
    if not findings:
        return error.name, str(error)
    first = findings[0]
    more = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
    return str(first["code"]), f"{first['message']}{more}. Remedy: {remedy(str(first['code']))}"


def _is_begun(hold: DeadManHold, press: Press) -> bool:
    """Wait until the page has returned a token; False: it did not in time, or the button was released."""
    while (phase := hold.phase(press, time.monotonic())) is HoldPhase.PRESSED:
        time.sleep(0.25 * PERIOD)
    return phase is HoldPhase.HELD


def _follow(client: Client, motion: JogMotion, hold: DeadManHold, press: Press) -> StopOutcome:
    last = time.monotonic()
    done_at = None
    is_ours = True  # a refusal may mean that another client moves the robot now: no Cancel then
    try:
        while hold.phase(press, now := time.monotonic()) is HoldPhase.HELD:
            if motion.is_done:
                done_at = now if done_at is None else done_at
                if now - done_at > SETTLED:
                    return StopOutcome(True, "there", "")
            positions, velocities = motion.advance(now - last)
            last = now
            client.call(
                "Setpoint",
                joint_names=motion.names,
                positions=positions,
                velocities=velocities,
                valid_for=VALID,
            )
            time.sleep(max(0.0, now + PERIOD - time.monotonic()))
    except CallError:
        is_ours = False
        raise
    finally:
        if is_ours:
            with contextlib.suppress(ClientError):
                client.call("Cancel")
    return LAPSED
