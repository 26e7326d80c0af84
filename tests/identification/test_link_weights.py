"""Weights are as uncertain as masses and cables make them; goals count as the bus carries them."""

from dataclasses import replace

import numpy as np

from tests.support.daemon_rig import known_binding, known_robot
from twind.gap.motion_samples import MotionSamples
from twind.identification.link_weights import LARGEST, SPREAD, link_weights
from twind.identification.robot_fit import sent_goals
from twind.twin.binding import bind


def stretched() -> MotionSamples:
    """Return the arm so101 in its ready pose."""
    bound = known_binding("so101").binding
    pose = bound.robot.poses["ready"]
    position = np.tile([pose[name] for name in bound.robot.names], (100, 1))
    unknown = np.full_like(position, np.nan)
    return MotionSamples(bound.robot.names, 0.01 * np.arange(100), position, position, unknown, unknown)


def test_a_weight_is_known_the_less_the_smaller_it_is_beside_what_a_cable_pulls() -> None:
    motion = stretched()
    weights = link_weights(known_binding("so101").binding, [motion])
    lift, roll, jaw = (motion.names.index(name) for name in ("shoulder_lift", "wrist_roll", "gripper"))
    assert 0.3 * SPREAD < weights.uncertainty(lift, 0.0) < SPREAD
    assert weights.uncertainty(lift, 0.0) < weights.uncertainty(lift, 1.9) < LARGEST
    assert weights.uncertainty(roll, 1.9) == weights.uncertainty(jaw, 1.9) == LARGEST


def test_the_shares_of_the_links_are_all_of_the_weight() -> None:
    weights = link_weights(known_binding("so101").binding, [stretched()])
    heavy = weights.weight > 1e-4
    assert heavy.any()
    np.testing.assert_allclose(weights.shares[heavy].sum(axis=1), 1.0)


def test_weights_come_from_readings_with_holes_too() -> None:
    motion = stretched()
    position = motion.position.copy()
    position[10:20, 2] = np.nan
    position[:, 5] = np.nan
    weights = link_weights(known_binding("so101").binding, [replace(motion, position=position)])
    assert np.isfinite(weights.weight).all()


def test_goals_are_those_of_whole_counts() -> None:
    goals = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 6))
    count = 2.0 * np.pi / 4096.0
    sent = sent_goals(bind(known_robot("so101"), None), goals)
    assert np.abs(sent - goals).max() <= 0.5 * count * (1.0 + 1e-9)
    np.testing.assert_allclose(sent / count, np.round(sent / count), atol=1e-9)
