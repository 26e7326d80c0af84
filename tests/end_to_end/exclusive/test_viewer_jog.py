"""Jog by the page of `twindctl view` in a real browser: whatever ends a held button ends the motion in time.

Measured from the event to the last change of the commanded position, as the daemon reports it.
"""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.support.bare_browser import BareTab, bare_browser
from tests.support.browser import missing
from tests.support.jog_rig import OVER, CommandedPosition, CuttableLine, answers, hold, middle, take_lease
from tests.support.processes import Daemon, simulated, until
from tests.support.viewer_process import viewing

pytestmark = [pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")]
BOUND = 0.3  # s from the event to the last change of the goal
JOINT = "head_yaw"
UP = f"hold: {JOINT} more"
DOWN = f"hold: {JOINT} less"
SLIDER = f"hold and drag: {JOINT} follows"


@dataclass
class Jogging:
    """A page with the lease, behind a line that can be cut, and the goal of the joint that it moves."""

    daemon: Daemon
    view: "subprocess.Popen[str]"
    line: CuttableLine
    page: BareTab
    goal: CommandedPosition

    def stops_after(self, event: Callable[[], object], name: str, what: str) -> float:
        """Seconds from the event to the last change of the goal. Hold this button until the event."""
        hold(self.page, self.goal, name)
        return self.goal.last_change_after(event, what)

    def nothing_moves(self) -> None:
        """For `OVER`, whatever was held back."""
        still = self.goal.last_change()
        time.sleep(OVER)
        assert self.goal.last_change() == still

    def answer(self, name: str) -> str:
        """Return the text beside a button after it was held for a moment."""
        self.page.pointer("mousePressed", *middle(self.page, name))
        time.sleep(0.5)
        self.lift(name)
        return answers(self.page)

    def lift(self, name: str = UP) -> None:
        """Release the pointer."""
        self.page.pointer("mouseReleased", *middle(self.page, name))


@contextmanager
def jogging(folder: Path) -> Iterator[Jogging]:
    with (
        simulated(folder) as running,
        viewing(running.sockets, "--operate") as (view, url),
        bare_browser() as page,
    ):
        parts = urlsplit(url)
        assert parts.port is not None
        line = CuttableLine(parts.port)
        goal = CommandedPosition(running, JOINT)
        try:
            page.open(f"http://127.0.0.1:{line.port}{parts.path}")
            button = f"document.querySelector('[aria-label=\"{UP}\"]')"
            until(lambda: page.value(f"!!{button}"), 90.0, "the buttons")
            yield Jogging(running, view, line, page, goal)
        finally:
            goal.close()
            line.close()


def test_a_held_button_moves_until_it_is_released_cut_off_frozen_hidden_or_closed(tmp_path: Path) -> None:
    with jogging(tmp_path) as rig:
        page = rig.page
        until(lambda: "LEASE_MISSING" in rig.answer(UP), 30.0, "a refusal beside the button")
        assert rig.goal.last_change() == 0.0
        take_lease(page, rig.daemon)

        took = {"released": rig.stops_after(rig.lift, UP, "button released")}

        x, y = middle(page, SLIDER)  # the joint is not far above 0, the middle of its range
        for _ in range(5):  # on a busy machine a hold lapses
            page.pointer("mouseMoved", x + 30, y)
            page.pointer("mousePressed", x + 30, y)
            with suppress(AssertionError):
                until(lambda: rig.goal.velocity() > 0.1, 3.0, "up, towards the slider")
                page.pointer("mouseMoved", x - 30, y)
                until(lambda: rig.goal.velocity() < -0.1, 3.0, "down, to where the slider was dragged")
                break
            page.pointer("mouseReleased", x, y)
        assert rig.goal.is_moving()
        let_go = partial(page.pointer, "mouseReleased", x - 30, y)
        took["slider"] = rig.goal.last_change_after(let_go, "slider released")

        took["cut off"] = rig.stops_after(rig.line.cut, DOWN, "packets dropped")
        rig.line.mend()  # what was held back comes now, with the button still held
        rig.nothing_moves()
        rig.lift(DOWN)

        took["frozen"] = rig.stops_after(lambda: page.signal(signal.SIGSTOP), UP, "browser SIGSTOPped")
        page.signal(signal.SIGCONT)
        rig.nothing_moves()
        rig.lift()

        took["hidden"] = rig.stops_after(page.hide, DOWN, "tab hidden")
        assert page.value("document.visibilityState") == "hidden"
        page.show()
        rig.nothing_moves()
        rig.lift(DOWN)

        took["closed"] = rig.stops_after(page.close, UP, "tab closed")
        assert max(took.values()) <= BOUND, took


@pytest.mark.parametrize("name", ["SIGKILL", "SIGSTOP"])
def test_a_viewer_that_is_killed_or_frozen_moves_nothing_on(tmp_path: Path, name: str) -> None:
    with jogging(tmp_path) as rig:
        take_lease(rig.page, rig.daemon)
        number = getattr(signal, name)
        took = rig.stops_after(lambda: os.kill(rig.view.pid, number), UP, f"viewer {name}")
        until(lambda: rig.daemon.status()["motion"] == "holding", 3.0, "the daemon holds")
        os.kill(rig.view.pid, signal.SIGCONT)  # it goes on with what it was about to send
        rig.nothing_moves()
        assert took <= BOUND
