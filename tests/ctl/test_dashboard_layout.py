"""The whole picture at several sizes, letter by letter, and what is dropped where there is little room."""

from itertools import product
from pathlib import Path

import pytest

from tests.support.picture_messages import NAMES, bus, joints, troubled, view
from twind.ctl.dashboard.dashboard_layout import PAGES, PageSelection, picture
from twind.ctl.dashboard.dashboard_renderer import plain
from twind.ctl.dashboard.dashboard_state import DashboardState
from twind.ctl.dashboard.styled_lines import length

GOLDEN = Path(__file__).parents[1] / "data" / "monitor"
SIZES = [(80, 24), (120, 40), (200, 60)]


@pytest.mark.parametrize(("width", "height"), SIZES)
@pytest.mark.parametrize("kind", ["fine", "troubled"])
def test_the_picture_is_this_to_the_letter(kind: str, width: int, height: int) -> None:
    """To change a picture: delete the file, run again, read what was written."""
    seen = view() if kind == "fine" else troubled()
    file = GOLDEN / f"{kind}-{width}x{height}.txt"
    shown = plain(picture(seen, width, height, None, seen.now)) + "\n"
    if not file.exists():
        file.write_text(shown)
        pytest.fail(f"{file.name} was not there: written, read it")
    assert shown == file.read_text()


def test_the_picture_never_exceeds_the_terminal() -> None:
    widths = (1, 2, 9, 20, 39, 40, 79, 81, 99, 100, 133, 184, 185, 250)
    for width, height in product(widths, (1, 2, 3, 5, 11, 24, 70)):
        for seen in (DashboardState(now=0.0), view(), troubled()):
            for page in PAGES:
                lines = picture(
                    seen, width, height, PageSelection(page, offset=7, frozen_since=1.0), seen.now
                )
                assert len(lines) <= height, (width, height)
                assert max(length(each) for each in lines) <= width, (width, height)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_every_picture_shows_the_fault_at_any_size_and_page(width: int, height: int) -> None:
    for page in PAGES:
        text = plain(picture(troubled(), width, height, PageSelection(page)))
        assert "!! FAULT !!" in text
        assert "FAULT  FOLLOW_ERR: l_knee" in text
        assert "do: check what blocks it, load and gains" in text
        assert "WARN  lower: the adapter's latency timer is 16 ms" in text


def test_the_rows_of_joints_move_by_keys_and_stop_at_their_end() -> None:
    def names(offset: int) -> list[str]:
        lines = plain(picture(view(), 80, 24, PageSelection(offset=offset))).splitlines()
        return [name for line in lines for name in NAMES if line[2:].startswith(f"{name} ")]

    first = names(0)
    last = names(500)
    assert first[0] == NAMES[0]
    assert names(3) == list(NAMES[3 : 3 + len(first)])
    assert last == list(NAMES[-len(last) :])


def test_a_picture_without_a_size_has_everything_and_no_line_of_keys() -> None:
    text = plain(picture(troubled(), 120, None))
    assert all(f" {name} " in text for name in NAMES)
    for said in ("latency, hop by hop", "ticks began late by", "refused last", "episode  pick the cup"):
        assert said in text
    assert "q ends" not in text


def test_a_frozen_picture_shows_for_how_long() -> None:
    seen = view()
    assert (
        plain(picture(seen, 80, 24, PageSelection(frozen_since=seen.now - 12.0), seen.now))
        .splitlines()[-1]
        .startswith(" FROZEN for 12 s  ")
    )


def test_a_robot_of_many_joints_and_buses_leaves_room_for_what_matters() -> None:
    many = [each | {"name": f"{each['name']}_{k}"} for k in range(4) for each in joints()]
    text = plain(picture(view(joints=many, buses=[bus(f"b{k}") for k in range(9)]), 80, 24))
    for said in ("lease ", "loop ", "latency ", "b0 ", "more buses", "more joints", "POS_LIMIT"):
        assert said in text
