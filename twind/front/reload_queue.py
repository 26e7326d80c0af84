"""Queue of changes while the daemon runs, the front's side: request, reading, sending, taking effect.

They run one at a time, in order of the requests. The loop decides whether a change may be made now. At its
reply the front takes the same values; until then both use the old ones. Front process.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgspec

from twind import link
from twind.briefing import Briefing, ReloadResult
from twind.config.hot_keys import BLOCK, LEVEL, WARN, of_robot
from twind.front.client_calls import ClientCall
from twind.front.front_core import FrontCore
from twind.front.state_cache import encode
from twind.front.trajectory_check_queue import NOBODY
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.sealed_memfd import seal

if TYPE_CHECKING:
    from twind.twin.trajectory_precheck import TrajectoryPrecheck

READING = 15.0  # s that reading and checking the files may take
ANSWER = 5.0  # s until the loop must have answered
WAITING = 8  # that may wait for their turn
AGAIN = 1.0  # s until gains that could not be put back are put back again
PARAMETERS = {"log_level": LEVEL, "latency_warn_ms": WARN, "latency_block_ms": BLOCK}  # of SetParameters


@dataclass(slots=True)
class ReloadRequest:
    """Request to read the files again, or of settings by a client. `call` None: the loop received SIGHUP."""

    call: ClientCall | None
    changes: dict[str, object] | None = None  # None: read the files
    reading: ReloadResult | None = None
    foresight: TrajectoryPrecheck | None = None  # by the new limits
    ticket: int = NOBODY
    deadline: float = 0.0  # s, of the loop's answer


class ReloadQueue:
    """Queue of reload requests: the one under way and those that wait."""

    def __init__(
        self, front: FrontCore, adopt: Callable[[Briefing, TrajectoryPrecheck | None], None]
    ) -> None:
        """Make the queue; `adopt` puts new values in force on this side."""
        self._front = front
        self._adopt = adopt
        self._waiting: deque[ReloadRequest] = deque()
        self._now: ReloadRequest | None = None
        self._reader: subprocess.Popen[bytes] | None = None  # the process that reads the files
        self._owner = NOBODY  # client that changed gains last: those under trial are its own
        self._put_back_at = 0.0  # s

    def close(self) -> None:
        """Stop the process that reads the files after the loop is gone: its result is not needed any more."""
        if self._reader is not None:
            self._reader.kill()

    def ask(self, call: ClientCall | None, changes: dict[str, Any] | None = None) -> None:
        """Read the files, or make `changes` (settings by their keys), when it is their turn."""
        if call is not None and len(self._waiting) >= WAITING:
            call.error("Busy", {"what": "reloads wait for each other: try again"})
            return
        if call is None and any(request.call is None for request in self._waiting):
            return  # two signals before the files are read: one reading serves both
        self._waiting.append(ReloadRequest(call, changes))
        self._next()

    def put_back_gains(self, now: float) -> None:
        """Put the gains of the files in force at rest, once the client that tries others lost its lease.

        The next front process has no client that does. Called in each round of housekeeping, once tick and
        overview are known.
        """
        world = self._front.world
        replaced = world.briefing.replaced_gains
        if not replaced or now < self._put_back_at:
            return
        overview = world.overview
        holder = NOBODY if overview is None else overview.lease_client
        if self._owner != NOBODY and self._owner == holder and self._owner in self._front.sessions:
            return
        tick = world.tick
        idle = self._now is None and not self._waiting
        if idle and tick is not None and not tick.armed:
            self._put_back_at = now + AGAIN
            self._waiting.append(ReloadRequest(None, dict(replaced)))
            self._next()

    def _next(self) -> None:
        if self._now is not None or not self._waiting:
            return
        request = self._now = self._waiting.popleft()
        briefing = self._front.world.briefing
        if request.changes is None:
            self._front.link.owe(link.ReloadStarted())
            working = self._front.loop.run_in_executor(None, self._work, briefing)
            working.add_done_callback(lambda done: self._read(request, done.result()))
            return
        try:
            from twind.front.reload_worker import with_settings  # noqa: PLC0415  a tenth of a second that no start needs

            made = with_settings(briefing, request.changes)
        except ValueError as error:  # InvalidInput: a value that may not change
            self._read(request, ReloadResult(error=str(error)))
        except (OSError, MemoryError, ImportError) as error:
            self._read(request, ReloadResult(error=_out_of(error)))
        else:
            self._read(request, ReloadResult(changes=request.changes, briefing=made))

    def _work(self, briefing: Briefing) -> ReloadResult:
        """Run in a thread, which waits for the process that reads the files."""
        program = [sys.executable, "-P", "-m", "twind.front.reload_worker"]
        pipe = subprocess.PIPE
        try:
            with subprocess.Popen(program, stdin=pipe, stdout=pipe, stderr=pipe) as self._reader:
                try:
                    output, errors = self._reader.communicate(msgspec.msgpack.encode(briefing), READING)
                except subprocess.TimeoutExpired:
                    self._reader.kill()
                    return ReloadResult(error=f"reading the files took longer than {READING:g} s")
            if self._reader.returncode != 0:
                last = errors.decode(errors="replace").strip().rpartition("\n")[2]
                return ReloadResult(error=f"reading the files broke ({self._reader.returncode}): {last}")
            return msgspec.msgpack.decode(output, type=ReloadResult)
        except (OSError, msgspec.MsgspecError) as error:
            return ReloadResult(error=f"reading the files broke: {error}")
        finally:
            self._reader = None

    def _read(self, request: ReloadRequest, reading: ReloadResult) -> None:
        """The files are read, and checked."""
        if reading.error or reading.briefing is None:
            if request.changes is None:
                self._front.link.owe(link.ReloadFailed(message=reading.error))
            self._report_refusal(request, [Finding(ReasonCode.CONFIG_REFUSED, message=reading.error)])
            return
        request.reading = reading
        if not of_robot(reading.changes):
            self._send(request)
            return
        made = self._front.loop.run_in_executor(None, _foresight, reading.briefing)
        made.add_done_callback(lambda done: self._on_precheck(request, done.result()))

    def _on_precheck(self, request: ReloadRequest, made: TrajectoryPrecheck | str) -> None:
        if isinstance(made, str):
            self._read(request, ReloadResult(error=made))
            return
        request.foresight = made
        self._send(request)

    def _send(self, request: ReloadRequest) -> None:
        """Send a request to the loop, which decides."""
        front = self._front
        reading = request.reading
        assert reading is not None
        assert reading.briefing is not None
        try:
            fd = seal("twind-briefing", msgspec.msgpack.encode(reading.briefing))
        except (OSError, MemoryError) as error:  # unsent, so it must end here, or all others wait
            self._read(request, ReloadResult(error=_out_of(error)))
            return
        request.ticket = front.tickets.number()
        request.deadline = front.now() + ANSWER
        command = link.ApplyChanges(
            ticket=request.ticket,
            client=NOBODY if request.call is None else request.call.caller.number,
            generation=reading.briefing.generation,
            changes=reading.changes,
            needs_restart=reading.needs_restart,
            reread=request.changes is None,
            on_trial=bool(reading.briefing.replaced_gains),
        )
        try:
            sent = front.link.send(command, fd)
        finally:
            os.close(fd)
        if not sent:
            front.loop.call_later(0.05, self._send_again, request)

    def _send_again(self, request: ReloadRequest) -> None:
        if self._now is request and self._front.now() < request.deadline:
            deadline = request.deadline
            self._send(request)
            request.deadline = deadline

    # ------------------------------------------------------------------------------- the loop's word

    def answer(self, reply: link.Reply) -> bool:
        """The loop's answer to what is under way: True when it was that."""
        request = self._now
        if request is None or request.ticket == NOBODY or reply.ticket != request.ticket:
            return False
        named = self._front.world.names.reply(reply.parameters)
        if reply.error is not None:
            self._finish_reload(lambda call: call.error(reply.error or "Busy", named))
            return True
        assert request.reading is not None
        assert request.reading.briefing is not None
        self._adopt(request.reading.briefing, request.foresight)
        if of_robot(request.reading.changes):
            self._owner = NOBODY if request.call is None else request.call.caller.number
        if request.changes is None:
            self._finish_reload(lambda call: call.reply(encode(named)))
        else:
            shown = {"parameters": request.reading.briefing.parameters, "needs_restart": []}
            self._finish_reload(lambda call: call.reply(encode(shown)))
        return True

    def check_timeout(self, now: float) -> None:
        """End this front if the loop does not answer: it may still have taken the values.

        The next front receives the values in force.
        """
        asked = self._now
        if asked is not None and asked.ticket != NOBODY and now > asked.deadline:
            self._front.log.write("error", EventCode.LOOP_SILENT, now, method="Reload")
            self._front.ended.set()

    def _report_refusal(self, request: ReloadRequest, findings: list[Finding]) -> None:
        self._finish_reload(lambda call: self._front.refuse(call, findings))

    def _finish_reload(self, answer: Any) -> None:
        request = self._now
        self._now = None
        if request is not None and request.call is not None:
            answer(request.call)
        self._front.loop.call_soon(self._next)


def _out_of(error: Exception) -> str:
    """Return why a change could not be made ready: what the front process has too little of."""
    return f"the front process is out of descriptors or memory: {error}; close connections, then try again"


def _foresight(briefing: Briefing) -> TrajectoryPrecheck | str:
    """Load the look-ahead in a thread. Returns a text with the reason if there is none."""
    from twind.twin.binding_transfer import foresight  # noqa: PLC0415  as in `foreseen`

    try:
        return foresight(briefing.binding, 1.0 / briefing.rate_hz)
    except Exception as error:  # noqa: BLE001  whatever it is: nothing is changed
        return f"no look-ahead with the new limits: {type(error).__name__}: {error}"
