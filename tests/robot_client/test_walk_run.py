"""Commands of a walk are bounded by what was tried."""

import numpy as np
import pytest

pytest.importorskip("mink", reason="the extra walk")

from twind.exceptions import InvalidInput
from twind.robot_client.walk_run import FASTEST, velocity


def test_the_fastest_tried_velocity_is_taken() -> None:
    forward, left, turn = FASTEST.tolist()
    assert np.array_equal(velocity((forward, -left, -turn)), FASTEST * [1.0, -1.0, -1.0])


@pytest.mark.parametrize(
    ("wanted", "name"),
    [((0.13, 0.0, 0.0), "forward"), ((0.0, -0.04, 0.0), "left"), ((0.0, 0.0, float("nan")), "turn")],
)
def test_a_velocity_beyond_what_was_tried_is_refused_by_name(
    wanted: tuple[float, float, float], name: str
) -> None:
    with pytest.raises(InvalidInput, match=name):
        velocity(wanted)
