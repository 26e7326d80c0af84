"""A servo that swings a mass is identified from real recordings; an unreadable CSV is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twind.exceptions import InvalidInput
from twind.identification.pendulum_fit import XL330, fit_pendulum, priors_of_pendulum, replay_error
from twind.identification.pendulum_recordings import PendulumRecording, load_pendulum

DATA = Path(__file__).parents[1] / "data" / "bam_xl330"
SHORT = 1.5  # s of each recording, to be fast


def recording(name: str) -> PendulumRecording:
    found = load_pendulum(DATA / f"xl330_{name}.csv.gz", {})
    kept = found.time < SHORT
    return replace(
        found,
        time=found.time[kept],
        position=found.position[kept],
        goal=found.goal[kept],
        torque_on=found.torque_on[kept],
    )


@pytest.mark.slow
def test_a_fit_predicts_a_motion_of_another_gain_better_than_the_figures_of_the_maker() -> None:
    fit = fit_pendulum([recording("kp200_sin_sin"), recording("kp100_lift_and_drop")])
    judged = [recording("kp800_up_and_down")]
    prior = replay_error(judged, priors_of_pendulum(XL330).mean)
    found = replay_error(judged, fit.values)
    assert found[0] < 0.8 * prior[0]


def test_a_recording_tells_mass_arm_and_gain_in_its_first_line() -> None:
    found = load_pendulum(DATA / "xl330_kp200_sin_sin.csv.gz", {})
    assert (found.mass, found.length, found.kp) == (0.49, 0.1, 200.0)
    assert found.time[0] == 0.0
    assert (np.diff(found.time) >= 0.0).all()


def test_a_csv_without_what_is_needed_is_refused_by_name(tmp_path: Path) -> None:
    file = tmp_path / "short.csv"
    file.write_text("timestamp,position\n0.0,1.0\n")
    with pytest.raises(InvalidInput, match="mass_kg is not known: give --mass"):
        load_pendulum(file, {})
    with pytest.raises(InvalidInput, match="no column 'goal_position'"):
        load_pendulum(file, {"mass_kg": 0.5, "length_m": 0.1, "kp": 200.0})
    file.write_text("timestamp,position,goal_position\n0.0,1.0,nan\n")
    with pytest.raises(InvalidInput, match="at least 100"):
        load_pendulum(file, {"mass_kg": 0.5, "length_m": 0.1, "kp": 200.0})
