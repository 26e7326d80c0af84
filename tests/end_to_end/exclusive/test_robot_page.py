"""The viewer's page in a real browser: what it shows, and what it asks for. The messages are made up."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from tests.support.browser import SELDOM, browser, changed, missing, opened, picture
from tests.support.viewer_messages import h24, other, state, status
from twind.observe.viewing.robot_connections import local
from twind.observe.viewing.robot_page import RobotPage
from twind.observe.viewing.robot_viewer import RobotViewer, run
from twind.observe.viewing.stop_threads import StopThreads
from twind.observe.viewing.viewer_access import ViewerSite
from twind.observe.viewing.viewer_access import opened as served
from twind.observe.viewing.viewer_state import RobotAnnounced, ViewerState

pytestmark = [pytest.mark.skipif(bool(missing()), reason=missing() or "there is one")]
SEEN = 150  # cells of 12,800 that a robot has at least
NOISE = 8  # that differ between two looks at the same


@dataclass
class Shown:
    """A viewer of made-up messages, and the page that shows it."""

    site: ViewerSite
    known: ViewerState
    page: Any

    def robot(self, visible: bool) -> None:
        """All but what stands in the world."""
        for body in range(1, 40):
            handle = self.site.server.scene.get_handle_by_name(f"/robots/0/solid/{body}")
            if handle is not None:
                handle.visible = visible

    def against_floor(self) -> int:
        """Cells that the robot has."""
        whole = picture(self.page)
        self.robot(visible=False)
        floor = picture(self.page)
        self.robot(visible=True)
        return int(changed(whole, floor).sum())


@pytest.fixture(scope="module")
def shown() -> Iterator[Shown]:
    known = ViewerState()
    ended = threading.Event()
    with browser() as found, served(None, "test") as site:
        viewer = RobotViewer(site, known, RobotPage(site, known, StopThreads(local("nowhere"))))
        drawing = threading.Thread(target=run, args=(viewer, known, (), ended))
        drawing.start()
        try:
            page = opened(found, site.url)
            page.add_style_tag(content=".mantine-Notifications-root {display: none}")  # WebGL is software
            yield Shown(site, known, page)
        finally:
            ended.set()
            drawing.join(10.0)


def steady_picture(page: Any) -> Any:
    """Return the picture once it no longer changes: meshes, light and shadows of a page come one by one."""
    last = picture(page)
    for _ in range(20):
        now = picture(page)
        if not changed(last, now).any():
            return now
        last = now
    raise AssertionError("the picture does not come to rest")


def test_the_robot_is_seen_and_its_pose_follows_a_motion(shown: Shown) -> None:
    told = h24()
    for news in (RobotAnnounced(told), status(), state(told)):
        shown.known.take(news)
    shown.page.locator("[data-twind-row]").first.wait_for(timeout=60_000)  # the robot was described
    before = steady_picture(shown.page)
    assert shown.against_floor() > SEEN

    shown.known.take(state(told, 1.0, l_shoulder_roll=1.5))
    raised = changed(before, picture(shown.page))
    middle = raised.shape[1] // 2  # its left is on our right
    assert raised[:, middle + 8 :].sum() > 40
    assert raised[:, : middle - 8].sum() < NOISE

    shown.known.take(state(told, 2.0))
    # Of what the arm changed; lines of the floor differ with the resolution that a slow machine gets.
    assert (changed(before, picture(shown.page)) & raised).sum() < NOISE


def test_a_stale_joint_is_drawn_in_red(shown: Shown) -> None:
    told = h24()
    shown.known.take(RobotAnnounced(told))
    shown.known.take(state(told, 3.0))
    usual = picture(shown.page)
    shown.known.take(state(told, 4.0, head_pitch={"heard": False, "age_ms": 900.0}))
    marked = picture(shown.page)
    red = changed(usual, marked) & (marked[:, :, 0] > marked[:, :, 1] + 40)
    assert red.sum() > 20
    assert shown.page.get_by_text("head_pitch").count() > 0


def test_a_goal_away_from_the_position_is_drawn_as_a_translucent_figure(shown: Shown) -> None:
    told = h24()
    shown.known.take(RobotAnnounced(told))
    shown.known.take(state(told, 5.0))
    usual = picture(shown.page)
    shown.known.take(state(told, 6.0, r_shoulder_roll={"goal": -1.5}))
    blue = picture(shown.page)
    ghost = changed(usual, blue) & (blue[:, :, 2] > blue[:, :, 0] + 30)
    assert ghost.sum() > 20


def test_a_model_whose_shapes_are_all_in_group_three_is_seen(shown: Shown) -> None:
    told = other()
    shown.known.take(RobotAnnounced(told))
    shown.known.take(state(told, 7.0))
    assert shown.against_floor() > SEEN


def test_the_page_asks_nothing_of_any_other_host(shown: Shown) -> None:
    here = shown.site.url.removeprefix("http://").rstrip("/")
    own = (f"http://{here}", f"ws://{here}", f"blob:http://{here.partition('/')[0]}/", "data:")
    assert len(shown.page.asked) >= 2
    assert [url for url in shown.page.asked if not url.startswith(own)] == []


# the stop button lies free at its middle, and what is drawn of the robot is covered by no sheet
LAYOUT = """() => {
  const stop = document.querySelector(".tw-estop").getBoundingClientRect();
  const at = document.elementFromPoint(stop.x + stop.width / 2, stop.y + stop.height / 2);
  const canvas = document.querySelector("canvas").getBoundingClientRect();
  const sheet = [...document.querySelectorAll(".mantine-Paper-root")]
    .filter(each => each.style.minHeight === "3.5em").map(each => each.getBoundingClientRect())[0];
  const apart = !sheet || sheet.left >= canvas.right - 1 || sheet.top >= canvas.bottom - 1;
  return [at?.className, stop.bottom <= innerHeight && stop.right <= innerWidth, apart,
    canvas.bottom <= stop.top, canvas.width * canvas.height / (innerWidth * innerHeight)];
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [(1280, 800), (700, 420), (390, 844)])
def test_the_stop_is_in_reach_and_no_panel_covers_the_robot(
    shown: Shown, size: tuple[int, int], scheme: str
) -> None:
    window = shown.page.context.browser.new_context(
        viewport={"width": size[0], "height": size[1]}, color_scheme=scheme
    )
    page = window.new_page()
    page.add_init_script(SELDOM)
    page.goto(shown.site.url)
    page.locator(".tw-estop").wait_for(timeout=60_000)
    page.locator("canvas").first.wait_for(timeout=60_000)
    page.get_by_text("translucent").wait_for(timeout=60_000)
    page.wait_for_timeout(300)
    stop, inside, apart, above, share = page.evaluate(LAYOUT)
    theme = page.evaluate("document.documentElement.dataset.mantineColorScheme")
    window.close()
    assert (stop, inside, apart, above, theme) == ("tw-estop", True, True, True, scheme)
    assert share > 0.35
