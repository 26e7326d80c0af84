"""Replies to e-stop calls. Each call is answered, however the stop ends."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from twind import link
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Priority
from twind.loop.procedures.torque_readback import torque_off
from twind.robot.arrays import some
from twind.robot.modes import Mode

STOPPING = (Priority.ESTOP, Priority.CUT)
KNOWN = 0.1  # s to wait for a device whose torque was not read back: two rounds of slow reads


@dataclass(eq=False)
class PendingEStop:
    """One e-stop call: answered once the stop has begun, and with `more` again at its end."""

    command: link.EStop
    begin_reported: bool = False
    deadline: float = inf  # s: the stop has ended, and torque that is unknown is waited for until then


class EStopReplies:
    """Calls that wait for a reply."""

    def __init__(self, context: ProcedureContext) -> None:
        self._context = context
        self._waiting: list[PendingEStop] = []

    def ask(self, command: link.EStop) -> None:
        """Add a call, to be answered once there is a confirmed state to report."""
        self._waiting.append(PendingEStop(command))

    def drop_client(self, client: int) -> None:
        """Drop the calls of a connection that is gone; the stop goes on."""
        self._waiting = [waiting for waiting in self._waiting if waiting.command.client != client]

    def answer(self) -> None:
        """Answer the calls that have something to report; called after each exchange."""
        running = self._context.procedures.rank in STOPPING
        for waiting in list(self._waiting):
            if not running and self._is_settled(waiting):
                live = self._context.condition.mode is Mode.LIVE
                self._send_reply(waiting, done=not live or torque_off(self._context) is not None)
                self._waiting.remove(waiting)
            elif running and self._context.torque.stop_begun and not waiting.begin_reported:
                waiting.begin_reported = True
                self._send_reply(waiting, done=False)
                if not waiting.command.more:
                    self._waiting.remove(waiting)

    def _is_settled(self, waiting: PendingEStop) -> bool:
        """Check that torque is known of every device; if not, wait for the next round of slow reads.

        A device whose reply came late while torque was read back is known again some 50 ms later. One on a
        closed bus is not waited for.
        """
        context = self._context
        if context.condition.mode is not Mode.LIVE or torque_off(context) is not None:
            return True
        if not some((context.hardware.slow.torque < 0) & context.hardware.open):
            return True
        now = context.clock.now()
        waiting.deadline = min(waiting.deadline, now + KNOWN)
        return now >= waiting.deadline

    def _send_reply(self, waiting: PendingEStop, *, done: bool) -> None:
        context = self._context
        more = waiting.command.more and context.procedures.rank in STOPPING
        state = context.condition.state.value
        off = torque_off(context)
        context.reports.reply(waiting.command, continues=more, state=state, torque_off=off, done=done)
