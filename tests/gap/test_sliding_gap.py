"""The live gap is of the last seconds of motion, whatever came before."""

import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.gap.gap_replay import GapReplay
from twind.gap.sliding_gap import LONGEST_PAUSE, SlidingGap
from twind.twin.binding import Binding, bind

PERIOD = 0.01


@pytest.fixture(scope="module")
def binding() -> Binding:
    return bind(load_robot("pan-tilt"), None)


def row(binding: Binding, time: float) -> np.ndarray:
    n = len(binding.robot.names)
    return np.concatenate([[time], binding.rest, binding.rest, np.zeros(n), np.zeros(n)])


def test_a_pause_begins_the_window_anew_and_is_not_simulated(binding: Binding) -> None:
    gap = SlidingGap(GapReplay(binding, PERIOD), binding.robot.names, PERIOD)
    full = [gap.add(row(binding, tick * PERIOD)) for tick in range(150)]
    assert full.count(True) == 1 and gap.gaps()
    hour = 3600.0
    assert not gap.add(row(binding, hour))
    assert gap.gaps() == []
    after = [gap.add(row(binding, hour + tick * PERIOD)) for tick in range(1, 150)]
    assert after.count(True) == 1 and gap.gaps()


def test_a_pause_shorter_than_the_bound_goes_on(binding: Binding) -> None:
    gap = SlidingGap(GapReplay(binding, PERIOD), binding.robot.names, PERIOD)
    for tick in range(150):
        gap.add(row(binding, tick * PERIOD))
    gap.add(row(binding, 1.49 + 0.9 * LONGEST_PAUSE))
    assert gap.gaps()
