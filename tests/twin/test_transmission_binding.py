"""A robot whose waist and ankle several actuators turn together: counts, limits and calibration of it."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support import transmission_robot_file as linked
from tests.support.examples import examples
from twind.config.calibration_file import dump_calibration, read_calibration
from twind.config.counts import slot_angles, ticks_of
from twind.config.identified_spec import IdentifiedJoint, IdentifiedModel, ParameterEstimate
from twind.config.robot_spec import RobotFile
from twind.exceptions import InvalidInput
from twind.loop.bus.joint_readings import NOWHERE, efforts, radians, ticks, velocities
from twind.robot.arrays import Floats
from twind.twin.binding import Binding, bind, rebound
from twind.virtual.virtual_robot_spec import calibration, make_spec

WAIST = ("waist_roll", "waist_yaw")
ANKLE = ("ankle_roll", "ankle_pitch")
RODS = ("ank_in", "ank_out")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return linked.write(tmp_path_factory.mktemp("linked"))


@pytest.fixture(scope="module")
def bound(path: Path) -> Binding:
    robot = linked.read_robot(path)
    return bind(robot, calibration(make_spec(robot)))


@given(shares=st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5))
def test_a_goal_within_the_hard_limits_is_within_the_counts_of_every_actuator(
    bound: Binding, shares: list[float]
) -> None:
    limits = bound.limits
    linked = [joint.transmission != "" for joint in bound.robot.joints]
    low = np.where(linked, limits.hard_lower, limits.lower)
    high = np.where(linked, limits.hard_upper, limits.upper)
    goal = low + np.array(shares) * (high - low)
    for bus in bound.joint_map.buses:
        sent = ticks(bus, goal)
        assert (sent >= bus.lower).all() and (sent <= bus.upper).all()
        assert radians(bus, sent) == pytest.approx(goal[bus.joints], abs=2e-3)


@given(
    shares=st.lists(st.floats(0.05, 0.95), min_size=5, max_size=5),
    raw=st.lists(st.integers(-300, 300), min_size=10, max_size=10),
)
def test_no_power_is_lost_between_counts_and_joints(
    bound: Binding, shares: list[float], raw: list[int]
) -> None:
    low = bound.limits.lower
    high = bound.limits.upper
    goal = low + np.array(shares) * (high - low)
    for bus in bound.joint_map.buses:
        place = ticks(bus, goal)
        count = len(bus.ids)
        speed = np.array(raw[:count], np.float64)
        effort = np.array(raw[-count:], np.float64)
        of_actuators = (effort * bus.effort_scale) @ (speed * bus.velocity_scale)
        of_joints = efforts(bus, place, effort) @ velocities(bus, place, speed)
        assert of_joints == pytest.approx(of_actuators, abs=1e-9)


def test_a_velocity_is_that_of_the_joints(bound: Binding) -> None:
    for bus in bound.joint_map.buses:
        before = np.array([0.1, 0.5, 0.05, -0.2, 0.1])
        after = before + 1e-3
        place = ticks(bus, before)
        exact = [np.array(law_angles(bound, pose)) for pose in (before, after)]
        raw = (exact[1] - exact[0])[bus.joints] / bus.velocity_scale
        assert velocities(bus, place, raw) == pytest.approx(np.full(len(bus.ids), 1e-3), rel=0.02)


def law_angles(bound: Binding, pose: Floats) -> list[float]:
    names = bound.robot.names
    angles = slot_angles(bound.robot, dict(zip(names, pose.tolist(), strict=True)))
    return [angles[name] for name in names]


def test_a_place_outside_the_table_is_no_goal(bound: Binding) -> None:
    (leg,) = (bus for bus in bound.joint_map.buses if bus.name == "leg")
    far = np.zeros(5)
    far[bound.robot.names.index("ankle_pitch")] = 1.5
    assert (np.abs(ticks(leg, far)) == NOWHERE).all()


def test_an_unknown_effort_of_one_actuator_is_unknown_at_both_joints(bound: Binding) -> None:
    main = bound.joint_map.buses[0]
    rows = main.linked[0].rows
    raw = np.zeros(3)
    raw[rows[0]] = math.nan
    told = efforts(main, main.zero, raw)
    assert np.isnan(told[rows]).all()
    assert np.isfinite(np.delete(told, rows)).all()


def test_full_effort_of_all_joints_of_a_transmission_exceeds_no_actuator(bound: Binding) -> None:
    names = bound.robot.names
    effort = bound.limits.effort
    torque = np.array([effort[names.index(name)] for name in WAIST])
    matrix = np.array([[-0.25, 0.25], [0.3, 0.3]])
    most = 1.78 * 2.3
    for sign in (1.0, -1.0):
        asked = matrix.T @ (torque * [1.0, sign])
        assert (np.abs(asked) <= np.array([most, 1.2 * most]) + 1e-9).all()


def test_limits_that_an_actuator_cannot_follow_are_refused_naming_joint_and_actuator(bound: Binding) -> None:
    robot = bound.robot
    known = calibration(make_spec(bound.robot))
    for actuator, joint in (("waist_b", "waist_yaw"), ("ank_in", "ankle_pitch")):
        shorter = tuple(
            replace(entry, sweep_ticks=(entry.sweep_ticks[0] + 300, entry.sweep_ticks[1]))
            if entry.name == actuator
            else entry
            for entry in known.joints
        )
        with pytest.raises(
            InvalidInput, match=f"{joint}: transmission .* ask actuator {actuator} for counts"
        ):
            bind(robot, replace(known, joints=shorter))


def waved(places: int) -> str:
    """A table with kinks anywhere along an edge of its joints' box."""
    axis = [1.15 * (2.0 * step / (places - 1) - 1.0) for step in range(places)]
    rows = [(a, b, 0.45 * a, 0.35 * b + 0.2 * math.cos(2.2 * a)) for a in axis for b in axis]
    return "\n".join([linked.HEAD, *(",".join(f"{number:.9f}" for number in row) for row in rows)])


@pytest.mark.parametrize("places", [5, 6, 15])
def test_an_accepted_goal_at_the_end_of_the_travel_is_not_clamped(tmp_path: Path, places: int) -> None:
    text = linked.ROBOT.replace(
        "ankle_roll: {limits_rad: [-0.2, 0.2]}", "ankle_roll: {limits_rad: [-0.1, 0.25]}"
    )
    robot = linked.linked(tmp_path, text.replace("[-0.4, 0.4]}\nact", "[-0.4, 0.37]}\nact"), waved(places))
    known = calibration(make_spec(robot))
    seats = {joint.actuator: joint for joint in robot.joints}
    entries = []
    for entry in known.joints:
        joint = seats[entry.name]
        ends = sorted(ticks_of(joint, entry.zero_ticks, angle) for angle in joint.span)
        entries.append(replace(entry, sweep_ticks=(ends[0], ends[1])) if entry.name in RODS else entry)
    tight = bind(robot, replace(known, joints=tuple(entries)))
    (leg,) = (bus for bus in tight.joint_map.buses if bus.name == "leg")
    roll, pitch = (robot.names.index(name) for name in ANKLE)
    goals = np.zeros((2, 401, 5))
    goals[:, :, pitch] = np.linspace(tight.limits.lower[pitch], tight.limits.upper[pitch], 401)
    goals[:, :, roll] = [[tight.limits.lower[roll]], [tight.limits.upper[roll]]]
    for goal in goals.reshape(-1, 5):
        sent = ticks(leg, goal)
        assert (sent >= leg.lower).all() and (sent <= leg.upper).all()


def test_a_count_too_little_takes_the_limits_in_a_little(bound: Binding) -> None:
    known = calibration(make_spec(bound.robot))
    entries = {entry.name: entry for entry in known.joints}
    joint = bound.robot.joints[0]  # waist_roll, on waist_a
    ends = sorted(ticks_of(joint, entries["waist_a"].zero_ticks, angle) for angle in joint.span)
    just = replace(entries["waist_a"], sweep_ticks=(ends[0] + 3, ends[1]))
    joints = tuple(just if entry.name == "waist_a" else entry for entry in known.joints)
    tight = bind(bound.robot, replace(known, joints=joints))
    assert -0.4 < tight.limits.lower[0] < -0.39
    assert tight.limits.hard_lower[0] == tight.limits.lower[0]
    assert tight.limits.lower[1] == bound.limits.lower[1]


@examples(20)
@given(st.sampled_from(["waist_a", "waist_b", "ank_in", "ank_out"]))
def test_a_joint_is_calibrated_when_all_its_actuators_are(bound: Binding, missing: str) -> None:
    known = calibration(make_spec(bound.robot))
    partly = replace(known, joints=tuple(entry for entry in known.joints if entry.name != missing))
    map_ = bind(bound.robot, partly).joint_map
    lacking = {name for name, whole in zip(map_.names, map_.calibrated, strict=True) if not whole}
    assert lacking == set(WAIST if missing.startswith("waist") else ANKLE)


def test_a_calibration_is_kept_by_the_names_of_actuators(bound: Binding) -> None:
    known = calibration(make_spec(bound.robot))
    assert [entry.name for entry in known.joints] == ["waist_a", "knee", "ank_out", "waist_b", "ank_in"]
    again = read_calibration(dump_calibration(known), "x.yaml", bound.robot)
    assert again.by_name.keys() == known.by_name.keys()


def test_narrower_limits_while_it_runs_are_the_joints(bound: Binding) -> None:
    robot: RobotFile = bound.robot
    joints = tuple(
        replace(joint, lower=-0.1, upper=0.3) if joint.name == "waist_roll" else joint
        for joint in robot.joints
    )
    again = rebound(bound, replace(robot, joints=joints), calibration(make_spec(robot)))
    assert again.limits.lower[0] == -0.1
    assert again.limits.hard_lower[0] == pytest.approx(-0.15)
    assert again.joint_map.buses[0].linked[0].lower[0] == again.limits.hard_lower[0]


def test_a_stiffness_that_is_shared_by_actuators_is_known_only_when_identified(bound: Binding) -> None:
    place = bound.robot.names.index(ANKLE[1])
    assert math.isnan(bound.ratings.stiffness[place])
    joints = {ANKLE[1]: IdentifiedJoint(stiffness_nm_per_rad=ParameterEstimate(25.0, 1.0, 30.0, 7.0))}
    model = IdentifiedModel(bound.robot.name, "2026-11-28T10:00:00Z", "test", "test", 1.0, 0.25, joints)
    again = rebound(bound, replace(bound.robot, identified=model), calibration(make_spec(bound.robot)))
    assert again.ratings.stiffness[place] == 25.0
