"""The lease in the hand of one browser tab, and what may be asked with it. Only with `--operate`.

A thread with a connection of its own holds and renews the lease. It is given back when the tab is gone;
while a call is under way it is not renewed, so it lapses by itself if the tab goes then.
"""

import contextlib
import queue
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from twind.client import Client, ClientError
from twind.client.move_duration import present_goals, slow_duration
from twind.command_line.trajectory_files import load_motion, motion_names
from twind.command_line.verb import Rejected, UsageError
from twind.observe.viewing.stop_threads import StopOutcome, Tell

RENEWED = 0.3  # s between two renewals; a lease lasts 1 s
# s between two checks that a page is there, and until it must have answered
ASKED = 0.5
ANSWER = 4.0
LEASE_ANSWER = 2.0  # s for the daemon's answer about the lease: after a second it has lapsed
SHORTEST = 2.0  # s, of the way to the rest pose

Work = Callable[[Client], StopOutcome]


class OperatorThread(threading.Thread):
    """At most one tab commands. Tabs are the numbers that viser gives them."""

    def __init__(self, place: str | None, changed: Callable[[int | None], None]) -> None:
        """`changed`: who holds the lease from now on, called in this thread."""
        super().__init__(name="operator", daemon=True)
        self._client = Client(place)
        self._changed = changed
        self._asked: queue.Queue[tuple[int, Work, Tell]] = queue.Queue(maxsize=1)
        self._busy = threading.Lock()  # held from the asking until the answer
        self._tab: int | None = None
        self._gone: set[int] = set()
        self.start()

    def take(self, tab: int, tell: Tell) -> None:
        """The lease for this tab. Refused while another tab has it."""
        self._gone.discard(tab)
        if self._tab not in (None, tab):
            tell(StopOutcome(False, "no lease", "another tab of this viewer holds the lease"))
            return

        def work(client: Client) -> StopOutcome:
            client.call("AcquireLease")
            self._now(tab)
            return StopOutcome(True, "lease taken", "this tab commands, until it gives it back or is closed")

        self._ask(tab, work, tell)

    def give(self, tab: int, tell: Tell) -> None:
        """Give the lease back."""

        def work(client: Client) -> StopOutcome:
            self._release()
            return StopOutcome(True, "lease given back", "a motion that ran holds")

        self._with_lease(tab, work, tell)

    def call(self, tab: int, work: Work, tell: Tell) -> None:
        """Something that needs the lease. Refused at once while another call is under way: nothing waits
        here to be done later."""

        def and_held(client: Client) -> StopOutcome:
            outcome = work(client)
            try:
                with client.within(LEASE_ANSWER):
                    client.call("AcquireLease")  # it may have taken longer than a lease lasts
            except ClientError as error:  # what was asked is done nevertheless
                self._release()
                return replace(outcome, text=f"{outcome.text}; the lease is gone: {error}")
            return outcome

        self._with_lease(tab, and_held, tell)

    def on_tab_closed(self, tab: int) -> None:
        """A tab was closed, or its page no longer answers. It may take the lease anew."""
        self._gone.add(tab)

    @property
    def holder(self) -> int | None:
        """The tab that holds the lease."""
        return self._tab

    def _with_lease(self, tab: int, work: Work, tell: Tell) -> None:
        if self._tab != tab:
            tell(StopOutcome(False, "not done", "this tab does not hold the lease"))
        else:
            self._ask(tab, work, tell)

    def _ask(self, tab: int, work: Work, tell: Tell) -> None:
        if not self._busy.acquire(blocking=False):
            tell(StopOutcome(False, "not done", "what was asked before is still being done"))
            return
        self._asked.put((tab, work, tell))

    # -------------------------------------------------------------------------------- its own thread

    def run(self) -> None:
        """Work as it comes; between, renew. Never ends: the page would show a lease that lapsed."""
        while True:
            try:
                self._turn()
            except Exception:  # noqa: BLE001
                traceback.print_exc()
                with contextlib.suppress(Exception):
                    self._release()

    def _turn(self) -> None:
        try:
            tab, work, tell = self._asked.get(timeout=RENEWED)
        except queue.Empty:
            self._hold()
            return
        try:
            outcome = self._done(work) if tab not in self._gone else None
        finally:
            self._busy.release()
        if outcome is not None:
            tell(outcome)
        self._hold()

    def _done(self, work: Work) -> StopOutcome:
        try:
            return work(self._client)
        except (ClientError, UsageError, Rejected) as error:
            return StopOutcome(False, "refused", str(error))
        except Exception as error:  # noqa: BLE001  an unreadable answer: what was done is unknown
            traceback.print_exc()
            return StopOutcome(False, "NOT confirmed", f"{type(error).__name__}: {error}")

    def _hold(self) -> None:
        """The lease, for as long as its tab is there."""
        if self._tab is None:
            return
        if self._tab in self._gone:
            self._release()
            return
        try:
            with self._client.within(LEASE_ANSWER):
                self._client.call("RenewLease")
        except ClientError:  # lapsed, taken by another, or the daemon is gone
            self._release()

    def _release(self) -> None:
        """Hanging up gives the lease back, whatever state the connection is in."""
        self._client.close()
        self._now(None)

    def _now(self, tab: int | None) -> None:
        if tab != self._tab:
            self._tab = tab
            self._changed(tab)


def look_after(operator: OperatorThread, tab: int, ask: Callable[[], object]) -> None:
    """While a tab holds the lease its page must answer: a connection whose other end is gone looks whole.

    `ask` raises TimeoutError where no answer came within `ANSWER`.
    """
    while operator.holder == tab:
        try:
            ask()
        except TimeoutError:
            operator.on_tab_closed(tab)
            return
        except RuntimeError:  # it answered with an error, or was closed, which is reported by itself
            pass
        except Exception:  # noqa: BLE001  the page cannot be asked
            traceback.print_exc()
            operator.on_tab_closed(tab)
            return
        time.sleep(ASKED)


# ---------------------------------------------------------------------------------------- what may be asked


def arm(client: Client) -> StopOutcome:
    """Torque on, where the joints are."""
    answer = client.call("Arm")
    warned = "; ".join(str(each["message"]) for each in answer.get("warnings") or ())
    return StopOutcome(True, "armed", f"{len(answer['joints'])} joints hold where they are" + warned)


def disarm(client: Client) -> StopOutcome:
    """To the rest pose, torque off."""
    return StopOutcome(True, "disarmed", f"state {client.call('Disarm')['state']}")


def motions(robot: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the robot's own motions."""
    folder = robot.get("motions")
    return motion_names(Path(folder)) if isinstance(folder, str) else ()


def play(robot: Mapping[str, Any], name: str) -> Work:
    """One of them, from where it begins."""

    def work(client: Client) -> StopOutcome:
        client.call("SubmitTrajectory", trajectory=load_motion(name, Path(robot["motions"])))
        return StopOutcome(True, "accepted", f"motion {name} runs")

    return work


def to_rest(robot: Mapping[str, Any]) -> Work:
    """All joints to the rest pose, slowly."""

    def work(client: Client) -> StopOutcome:
        rest = robot["poses"]["rest"]
        seconds = max(SHORTEST, slow_duration(rest, present_goals(client)))
        point = {"positions": list(rest.values()), "time_from_start": seconds}
        path = {"joint_names": list(rest), "points": [point], "policy": "retime"}
        client.call("SubmitTrajectory", trajectory=path)
        return StopOutcome(True, "accepted", f"to the rest pose in {seconds:.1f} s")

    return work
