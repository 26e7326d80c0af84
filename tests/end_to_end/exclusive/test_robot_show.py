"""`twindctl robot show` in a real browser: sliders without a daemon, and a daemon's angles with --live."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.browser import browser, missing, opened
from tests.support.processes import go, simulated, twindctl
from tests.support.viewer_process import WAIT

pytestmark = [pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")]


@contextmanager
def showing(*options: str) -> Iterator[Any]:
    """The page of `twindctl robot show` with these options."""
    with twindctl(*options) as process, browser() as found:
        assert process.stdout is not None
        address = process.stdout.readline().split()[1]
        yield opened(found, address, looked_at=False, shows="about the arrow by the right hand")


def test_a_slider_moves_its_joint_and_names_it(tmp_path: Path) -> None:
    with showing("--socket", str(tmp_path), "robot", "show", "h24") as page:
        page.get_by_text("bus main, id 1,").wait_for(timeout=WAIT)
        number = page.locator("input[type=text]").nth(4)  # the first is the choice of the joint
        number.fill("0.5")
        number.press("Enter")
        page.get_by_text("0.5").first.wait_for(timeout=WAIT)
        page.get_by_text("0.500 rad (29°)").wait_for(timeout=WAIT)
        assert page.get_by_text("bus main, id 1,").count() == 0  # another joint is chosen


def test_live_shows_the_angles_of_the_daemon_and_no_slider(tmp_path: Path) -> None:
    with simulated(tmp_path) as running, running.client() as client:
        go(client, {"joint_names": ["head_yaw"], "points": [{"positions": [0.25], "time_from_start": 1.0}]})
        with showing("--socket", str(tmp_path), "robot", "show", "h24", "--live") as page:
            page.get_by_text("0.250 rad (14°)").wait_for(timeout=WAIT)
            page.get_by_text("h24, mode sim").wait_for(timeout=WAIT)
            assert page.get_by_text("angles, rad").count() == 0
