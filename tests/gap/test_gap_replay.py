from dataclasses import replace

import numpy as np
import pytest

from twind.config.identified_spec import IdentifiedBody, IdentifiedModel, ParameterEstimate
from twind.config.robot_file import load_robot
from twind.gap.gap_figures import total_gap
from twind.gap.gap_replay import GapReplay
from twind.gap.motion_samples import MotionSamples
from twind.gap.sliding_gap import SlidingGap
from twind.twin.binding import Binding, bind
from twind.twin.simulation import Simulation

PERIOD = 0.01


def robot(factor: float = 1.0) -> Binding:
    described = load_robot("pan-tilt")
    plain = bind(described, None)
    masses = {
        plain.model.body(at).name: float(plain.model.body_mass[at]) for at in range(1, plain.model.nbody)
    }
    bodies = {
        name: IdentifiedBody(ParameterEstimate(factor * mass, 0.0, mass, 0.0))
        for name, mass in masses.items()
        if mass > 0.0 and name
    }
    model = IdentifiedModel(described.name, "", "", "", 0.0, 0.0, {}, bodies)
    return bind(replace(described, identified=model), None)


def motion(binding: Binding, seconds: float = 4.0) -> MotionSamples:
    simulation = Simulation(binding, PERIOD)
    time = PERIOD * np.arange(round(seconds / PERIOD))
    goal = binding.rest + 0.3 * (1.0 - np.cos(3.0 * time))[:, None]
    rows = []
    for at, wanted in zip(time, goal, strict=True):
        state = simulation.state(at)
        rows.append((state.position, state.velocity, state.effort))
        simulation.step(wanted)
    position, velocity, effort = map(np.array, zip(*rows, strict=True))
    return MotionSamples(binding.robot.names, time, goal, position, velocity, effort)


def test_the_robot_of_the_model_has_no_gap_and_a_heavier_one_has() -> None:
    replay = GapReplay(robot(), PERIOD)
    same = total_gap(replay.gaps(motion(robot())))
    heavy = total_gap(replay.gaps(motion(robot(1.5))))
    assert same is not None and same.unexplained is not None and same.unexplained < 1e-6
    assert heavy is not None and heavy.unexplained is not None and heavy.unexplained > 0.01


def test_a_sliding_window_has_the_figures_of_the_whole_motion() -> None:
    replay = GapReplay(robot(), PERIOD)
    measured = motion(robot(1.5), 4.02)
    window = SlidingGap(replay, measured.names, PERIOD)
    for place, time in enumerate(measured.time):
        columns = (measured.goal, measured.position, measured.velocity, measured.effort)
        window.add(np.concatenate([[time], *(column[place] for column in columns)]))
    whole = total_gap(replay.gaps(measured))
    sliding = total_gap(window.gaps())
    assert whole is not None and sliding is not None
    assert sliding.unexplained == pytest.approx(whole.unexplained, rel=0.05)


def test_a_second_with_an_unknown_position_is_left_out() -> None:
    measured = motion(robot())
    position = measured.position.copy()
    position[150] = np.nan
    found = GapReplay(robot(), PERIOD).gaps(replace(measured, position=position))
    assert found[0].samples == len(measured.time) - 101
