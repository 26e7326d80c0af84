"""Replies to e-stop calls. Each call is answered, however the stop ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from twind import link
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.modes import Mode

if TYPE_CHECKING:
    from twind.loop.tick.control_loop import Loop


@dataclass(eq=False)
class PendingEStop:
    """One e-stop call: answered once the stop has begun, and with `more` again at its end."""

    command: link.EStop
    begin_reported: bool = False


class EStopReplies:
    """Replies to e-stop calls."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._waiting: list[PendingEStop] = []

    def ask(self, command: link.EStop) -> None:
        """Add a call, to be answered once there is a confirmed state to report."""
        self._waiting.append(PendingEStop(command))

    def drop_client(self, client: int) -> None:
        """Drop the calls of a connection that is gone; the stop goes on."""
        self._waiting = [waiting for waiting in self._waiting if waiting.command.client != client]

    def answer(self) -> None:
        """Answer the calls that have something to report; called after each exchange."""
        running = self._loop.procedures.rank in (Priority.ESTOP, Priority.CUT)
        for waiting in list(self._waiting):
            if not running:
                confirmed = self._loop.mode is not Mode.LIVE or self._loop.torque_off is not None
                self._send_reply(waiting, done=confirmed)
                self._waiting.remove(waiting)
            elif self._loop.torque.stop_begun and not waiting.begin_reported:
                waiting.begin_reported = True
                self._send_reply(waiting, done=False)
                if not waiting.command.more:
                    self._waiting.remove(waiting)

    def _send_reply(self, waiting: PendingEStop, *, done: bool) -> None:
        loop = self._loop
        more = waiting.command.more and self._loop.procedures.rank in (Priority.ESTOP, Priority.CUT)
        off = loop.torque_off
        loop.say.reply(waiting.command, continues=more, state=loop.state.value, torque_off=off, done=done)
