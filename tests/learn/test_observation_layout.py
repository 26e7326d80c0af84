"""The observation, entry by entry, and the page that documents it."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from twind.learn.task.observation_layout import ObservationLayout, table

LAYOUT = ObservationLayout(("l_knee", "r_knee"))
DOCS = Path(__file__).parents[2] / "docs" / "learn.md"


@pytest.mark.parametrize("joints", [1, 2, 24])
def test_there_are_four_entries_a_joint_and_thirty_two_more(joints: int) -> None:
    layout = ObservationLayout(tuple(f"j{i}" for i in range(joints)))
    assert layout.size == 4 * joints + 32 == len(layout.names) == len(layout.most)


def test_parts_follow_one_another_without_a_gap_and_the_base_lies_between_lag_and_command() -> None:
    places = [LAYOUT.places[part.name] for part in LAYOUT.parts]
    assert places[0].start == 0
    assert all(one.stop == next_.start for one, next_ in pairwise(places))
    assert places[-1].stop == LAYOUT.size
    base = LAYOUT.places["base"]
    assert (base.start, base.stop) == (LAYOUT.places["lag"].stop, LAYOUT.places["command"].start)
    assert base.stop - base.start == 25
    assert (LAYOUT.most >= 1.0).all() and np.isfinite(LAYOUT.most).all()


def test_every_entry_has_a_name_of_its_own() -> None:
    assert len(set(LAYOUT.names)) == LAYOUT.size
    assert LAYOUT.names[1] == "position.r_knee"
    assert LAYOUT.names[LAYOUT.places["height"].start] == "height.z"
    assert LAYOUT.names[-4:] == ("phase.left.sin", "phase.left.cos", "phase.right.sin", "phase.right.cos")


def test_the_page_has_the_table_of_entries_as_the_code_has_it() -> None:
    rows = [f"| {places} | `{name}` | {unit or '–'} | {text} |" for places, name, unit, text in table(LAYOUT)]
    assert "\n".join(rows) in DOCS.read_text()
