"""`twindctl view` in a real browser while one simulated daemon ends and another one starts."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.browser import browser, missing, opened
from tests.support.processes import simulated
from tests.support.viewer_process import WAIT, press, viewing

pytestmark = [pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")]


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        yield found


def test_the_page_outlives_the_daemon_and_shows_the_next_ones_robot(chromium: Any, tmp_path: Path) -> None:
    with simulated(tmp_path) as first, viewing(tmp_path) as (view, url):
        page = opened(chromium, url, looked_at=False)
        page.get_by_text("h24, mode sim").wait_for(timeout=WAIT)
        first.kill()
        page.get_by_text("the daemon is not there, tried again").wait_for(timeout=WAIT)
        press(page, "E-STOP")
        page.get_by_text("use its own switch").wait_for(timeout=WAIT)
        with simulated(tmp_path, "h24-split"):
            page.get_by_text("h24-split, mode sim").wait_for(timeout=WAIT)
            view.terminate()
            assert view.wait(10.0) == 0
        page.close()
