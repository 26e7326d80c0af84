"""Draws from an identified model: within its uncertainty, and nothing else changes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twind.config.identified_file import dump_identified
from twind.config.identified_spec import (
    IdentifiedBody,
    IdentifiedJoint,
    IdentifiedModel,
    ParameterEstimate,
    PositionEstimate,
)
from twind.config.robot_file import load_robot
from twind.learn.environment.sim_body import SimBody
from twind.learn.randomise.identified_ranges import randomised_robot, with_measured
from twind.learn.randomise.measured_spread import CUT, spread_within
from twind.learn.randomise.randomisation_ranges import DrawSampler, EpisodeDraw, load_ranges
from twind.learn.task.plant_model import plant_of

ROBOT = load_robot("h24")
KNEE = ROBOT.names.index("l_knee")
LINKS = ("torso", "pelvis", "l_shin")
DRAWS = 400


def estimate(value: float, sd: float, *, determined: bool = True) -> ParameterEstimate:
    return ParameterEstimate(value, sd, value, sd, determined)


def model_of(joint: IdentifiedJoint, bodies: dict[str, IdentifiedBody] | None = None) -> IdentifiedModel:
    return IdentifiedModel(
        "h24", "2026-11-28T10:00:00Z", "test", "test", 1.0, 0.25, {"l_knee": joint}, bodies or {}
    )


KNEE_MODEL = model_of(
    IdentifiedJoint(
        stiffness_nm_per_rad=estimate(30.0, 1.5),
        damping_nm_s_per_rad=estimate(0.5, 0.1),
        friction_nm=estimate(0.2, 0.2),
        armature_kg_m2=estimate(0.02, 0.0),
        delay_s=estimate(0.012, 0.001),
    )
)


def draws_of(model: IdentifiedModel, profile: str = "default") -> list[EpisodeDraw]:
    ranges = with_measured(load_ranges(profile), ROBOT, model)
    sampler = DrawSampler(ranges, len(ROBOT.names), len(LINKS), LINKS)
    rng = np.random.default_rng(0)
    return [sampler.draw(rng) for _ in range(DRAWS)]


def test_measured_factors_have_their_relative_uncertainty() -> None:
    draws = draws_of(KNEE_MODEL)
    stiffness = np.array([draw.stiffness[KNEE] for draw in draws])
    assert stiffness.mean() == pytest.approx(1.0, abs=0.01)
    assert stiffness.std() == pytest.approx(0.05 * 0.95, abs=0.006)  # the cut takes 5 % of a normal spread
    assert np.abs(stiffness - 1.0).max() <= CUT * 0.05
    assert {draw.armature[KNEE] for draw in draws} == {1.0}


def test_values_stay_within_physical_bounds() -> None:
    friction = np.array([draw.frictionloss[KNEE] for draw in draws_of(KNEE_MODEL)])
    assert friction.min() >= 0.1
    assert friction.max() > 2.5


def test_damping_and_back_emf_get_one_factor() -> None:
    assert all(draw.damping[KNEE] == draw.braking[KNEE] for draw in draws_of(KNEE_MODEL))


def test_other_joints_keep_the_range_of_the_profile_and_one_common_delay() -> None:
    draws = draws_of(KNEE_MODEL)
    others = np.arange(len(ROBOT.names)) != KNEE
    stiffness = np.array([draw.stiffness[others] for draw in draws])
    delay = np.array([draw.action_delay for draw in draws])
    assert 0.9 <= stiffness.min() < 0.905
    assert 1.095 < stiffness.max() <= 1.1
    assert (delay[:, others] == delay[:, others][:, :1]).all()
    assert 0.005 <= delay[:, others].min() < 0.006
    assert np.abs(delay[:, KNEE] - 0.012).max() <= CUT * 0.001


def test_a_profile_without_ranges_varies_what_was_measured_alone() -> None:
    draw = draws_of(KNEE_MODEL, "none")[0]
    assert np.flatnonzero(draw.stiffness != 1.0).tolist() == [KNEE]
    assert (draw.mass == 1.0).all()


def test_parameters_that_the_data_do_not_determine_keep_their_range() -> None:
    unknown = model_of(IdentifiedJoint(stiffness_nm_per_rad=estimate(30.0, 15.0, determined=False)))
    zero = model_of(IdentifiedJoint(friction_nm=estimate(0.0, 0.1)))
    default = load_ranges("default")
    assert with_measured(default, ROBOT, unknown) == default
    assert with_measured(default, ROBOT, zero) == default


def test_masses_find_their_link_by_name_and_the_base_its_centre() -> None:
    centre = PositionEstimate((0.0, 0.0, 0.01), (0.0, 0.0, 0.004), (0.0, 0.0, 0.0))
    bodies = {
        "l_shin": IdentifiedBody(mass_kg=estimate(0.2, 0.002)),
        ROBOT.base: IdentifiedBody(com_m=centre),
    }
    draws = draws_of(model_of(IdentifiedJoint(), bodies))
    mass = np.array([draw.mass for draw in draws])
    com = np.array([draw.centre_of_mass for draw in draws])
    assert np.abs(mass[:, 2] - 1.0).max() <= CUT * 0.01
    assert np.abs(mass[:, :2] - 1.0).max() > 0.09
    assert not com[:, :2].any()
    assert 0.005 < np.abs(com[:, 2]).max() <= CUT * 0.004


def test_a_spread_at_its_bound_is_cut_there() -> None:
    spread = spread_within(0.0, 0.01, 0.0, 0.2)
    values = [spread.at(share) for share in np.linspace(0.0, 1.0, 21)]
    assert values == sorted(values)
    assert values[0] == 0.0
    assert values[-1] == pytest.approx(CUT * 0.01)


def test_a_simulation_draws_around_the_identified_model(tmp_path: Path) -> None:
    file = tmp_path / "h24.identified.yaml"
    file.write_text(dump_identified(replace(KNEE_MODEL, bodies={})))
    described = randomised_robot("h24", None, file)
    ranges = described.ranges
    plant = plant_of(described.robot, period=0.02, action_delay=ranges.longest_action_delay, imu_delay=0.015)
    body = SimBody(plant, ranges, 0.02)
    servo = plant.places.actuators[KNEE]
    found = []
    for seed in range(3):
        body.reset(np.random.default_rng(seed))
        found.append(float(body.model.actuator_gainprm[servo, 0]))
    assert len(set(found)) == 3
    assert all(abs(each - 30.0) <= CUT * 1.5 for each in found)
