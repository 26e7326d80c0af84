"""A robot whose waist and ankle several actuators turn together: the whole daemon, and the virtual body."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import linked
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import Rig

from twind import link
from twind.config.calibration_file import dump_calibration, read_calibration
from twind.config.counts import slot_angles, ticks_of
from twind.config.edited import fingerprint
from twind.config.files import Sources, describe
from twind.config.hot import Difference, robot_difference
from twind.config.robot_spec import RobotFile
from twind.loop.readings import NOWHERE, efforts, radians, ticks, velocities
from twind.robot.arrays import Floats
from twind.robot.trajectory import Trajectory
from twind.twin.binding import Binding, BindingError, bind, rebound
from twind.virtual.specimen import buses, calibration, specimen
from twind.virtual.truth import random_truth

WAIST, ANKLE = ("waist_roll", "waist_yaw"), ("ankle_roll", "ankle_pitch")


class Body(Rig):
    """The rig with MuJoCo's body in place of joints without load."""

    def _virtual(self, bus: str, start: Mapping[str, float]) -> Any:
        self.served = getattr(self, "served", None) or buses(self.made, now=self.clock.now())
        return self.served[bus]

    @property
    def truth(self) -> Floats:
        self._advance()
        whole = self.served["main"].servos.muscles._whole
        places = [whole.model.joint(joint.model_joint).qposadr[0] for joint in self.robot.joints]
        return np.array(whole.data.qpos[places])


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return linked.write(tmp_path_factory.mktemp("linked"))


@pytest.fixture
def rig(path: Path) -> Iterator[Rig]:
    made = Rig(str(path))
    yield made
    made.close()


@pytest.fixture(scope="module")
def bound(path: Path) -> Binding:
    robot = linked.read_robot(path)
    return bind(robot, calibration(specimen(robot)))


def bent(rig: Rig) -> Floats:
    return np.array([rig.robot.poses["bent"][name] for name in rig.names])


def move(rig: Rig, goal: Floats, seconds: float = 2.5) -> float:
    """All joints there; the largest difference on the way between what was read and what is true, rad."""
    rig.lease()
    both = np.stack([rig.loop.measured.position, goal])
    path = Trajectory(np.array([0.0, seconds]), both, np.ones(len(goal), np.bool_))
    ticket, worst = rig.submit(path), 0.0
    for tick in range(round((seconds + 1.0) * 100)):
        rig.ticks(1)
        worst = max(worst, float(np.abs(rig.truth - rig.loop.measured.position).max()))
        if tick % 50 == 0:
            rig.lease()
    assert rig.replies(ticket)[-1].parameters["verdict"]["refusals"] == []
    return worst


def test_it_arms_moves_reads_what_is_true_and_disarms(rig: Rig) -> None:
    rig.arm()
    worst = move(rig, bent(rig))
    assert rig.truth == pytest.approx(bent(rig), abs=2e-3)
    assert worst < 0.02  # of a reading that is some ms old
    assert rig.loop.measured.position == pytest.approx(rig.truth, abs=1e-3)
    assert rig.call(link.Disarm, ticks=2000).error is None
    assert rig.loop.state == "connected"
    assert not rig.register("torque_enable").any()
    assert rig.truth == pytest.approx(np.zeros(5), abs=2e-3)


def test_an_ankle_of_can_actuators_goes_where_it_is_sent_too(tmp_path: Path) -> None:
    rig = Rig(str(linked.write(tmp_path, linked.CAN_ROBOT)))
    rig.arm()
    move(rig, bent(rig))
    assert rig.truth == pytest.approx(bent(rig), abs=5e-3)
    assert rig.loop.measured.position == pytest.approx(rig.truth, abs=2e-3)
    assert rig.call(link.Disarm, ticks=2000).error is None
    rig.close()


@pytest.mark.slow
@pytest.mark.parametrize("text", [linked.ROBOT, linked.CAN_ROBOT], ids=["servos", "can"])
def test_a_body_behind_its_transmissions_goes_where_it_is_sent(tmp_path: Path, text: str) -> None:
    rig = Body(str(linked.write(tmp_path, text)))
    rig.arm()
    worst = move(rig, bent(rig))
    assert worst < 2e-3
    resolution = rig.loop.hardware.resolution
    assert (np.abs(rig.truth - rig.loop.measured.position) <= resolution).all()
    sag = np.abs(rig.truth - bent(rig))
    assert sag[rig.names.index("knee")] < 0.1  # a position loop without I hangs a little
    assert np.delete(sag, rig.names.index("knee")).max() < 0.01
    rig.close()


@pytest.mark.parametrize(("silent", "joints", "bus"), [(3, WAIST, "main"), (5, ANKLE, "leg")])
def test_where_one_actuator_is_silent_all_its_joints_are(
    rig: Rig, silent: int, joints: tuple[str, ...], bus: str
) -> None:
    rig.connect()
    rig.virtual[bus].faults.silence(silent)
    rig.seconds(0.3)
    state = rig.loop.measured
    quiet = {name for name, heard in zip(rig.names, state.heard.tolist(), strict=True) if not heard}
    assert quiet == set(joints)
    for name in joints:
        assert state.age[rig.names.index(name)] > 0.2
    assert state.age[rig.names.index("knee")] < 0.05


def test_an_armed_robot_faults_when_half_a_differential_is_silent(rig: Rig) -> None:
    rig.arm()
    rig.virtual["main"].faults.silence(3)
    rig.seconds(0.7)
    told = [finding.joint for event in rig.events("STATE_STALE") for finding in event.findings]
    assert {rig.names[joint] for joint in told if joint is not None} == set(WAIST)
    assert rig.loop.state == "fault"


@given(shares=st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5))
def test_a_goal_within_the_hard_limits_is_within_the_counts_of_every_actuator(
    bound: Binding, shares: list[float]
) -> None:
    limits, linked = bound.limits, [joint.transmission != "" for joint in bound.robot.joints]
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
    low, high = bound.limits.lower, bound.limits.upper
    goal = low + np.array(shares) * (high - low)
    for bus in bound.joint_map.buses:
        place, count = ticks(bus, goal), len(bus.ids)
        speed, effort = np.array(raw[:count], np.float64), np.array(raw[-count:], np.float64)
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


def test_what_all_joints_of_a_transmission_may_give_at_once_no_actuator_exceeds(bound: Binding) -> None:
    names, effort = bound.robot.names, bound.limits.effort
    torque = np.array([effort[names.index(name)] for name in WAIST])
    matrix = np.array([[-0.25, 0.25], [0.3, 0.3]])
    most = 1.78 * 2.3
    for sign in (1.0, -1.0):
        asked = matrix.T @ (torque * [1.0, sign])
        assert (np.abs(asked) <= np.array([most, 1.2 * most]) + 1e-9).all()


def test_limits_that_an_actuator_cannot_follow_are_refused_naming_joint_and_actuator(bound: Binding) -> None:
    robot, known = bound.robot, calibration(specimen(bound.robot))
    for actuator, joint in (("waist_b", "waist_yaw"), ("ank_in", "ankle_pitch")):
        shorter = tuple(
            replace(entry, sweep_ticks=(entry.sweep_ticks[0] + 300, entry.sweep_ticks[1]))
            if entry.name == actuator
            else entry
            for entry in known.joints
        )
        with pytest.raises(
            BindingError, match=f"{joint}: transmission .* ask actuator {actuator} for counts"
        ):
            bind(robot, replace(known, joints=shorter))


def test_a_count_too_little_takes_the_limits_in_a_little(bound: Binding) -> None:
    known = calibration(specimen(bound.robot))
    entries = {entry.name: entry for entry in known.joints}
    joint = bound.robot.joints[0]  # waist_roll, on waist_a
    ends = sorted(ticks_of(joint, entries["waist_a"].zero_ticks, angle) for angle in joint.span)
    just = replace(entries["waist_a"], sweep_ticks=(ends[0] + 3, ends[1]))
    joints = tuple(just if entry.name == "waist_a" else entry for entry in known.joints)
    tight = bind(bound.robot, replace(known, joints=joints))
    assert -0.4 < tight.limits.lower[0] < -0.39
    assert tight.limits.hard_lower[0] == tight.limits.lower[0]
    assert tight.limits.lower[1] == bound.limits.lower[1]


@settings(max_examples=20)
@given(st.sampled_from(["waist_a", "waist_b", "ank_in", "ank_out"]))
def test_a_joint_is_calibrated_when_all_its_actuators_are(bound: Binding, missing: str) -> None:
    known = calibration(specimen(bound.robot))
    partly = replace(known, joints=tuple(entry for entry in known.joints if entry.name != missing))
    map_ = bind(bound.robot, partly).joint_map
    lacking = {name for name, whole in zip(map_.names, map_.calibrated, strict=True) if not whole}
    assert lacking == set(WAIST if missing.startswith("waist") else ANKLE)


def test_a_calibration_is_kept_by_the_names_of_actuators(bound: Binding) -> None:
    known = calibration(specimen(bound.robot))
    assert [entry.name for entry in known.joints] == ["waist_a", "knee", "ank_out", "waist_b", "ank_in"]
    again = read_calibration(dump_calibration(known), "x.yaml", bound.robot)
    assert again.by_name.keys() == known.by_name.keys()


def test_narrower_limits_while_it_runs_are_the_joints(bound: Binding) -> None:
    robot: RobotFile = bound.robot
    joints = tuple(
        replace(joint, lower=-0.1, upper=0.3) if joint.name == "waist_roll" else joint
        for joint in robot.joints
    )
    again = rebound(bound, replace(robot, joints=joints), calibration(specimen(robot)))
    assert again.limits.lower[0] == -0.1
    assert again.limits.hard_lower[0] == pytest.approx(-0.15)
    assert again.joint_map.buses[0].linked[0].lower[0] == again.limits.hard_lower[0]


def test_what_reaches_too_far_is_held_at_the_joints_hard_limits(rig: Rig) -> None:
    hard = rig.one.binding.limits
    near = rig.loop.hardware.reachable(np.full(5, 3.0))
    assert near[0] == hard.hard_upper[0]
    assert near[2] == hard.hard_upper[2]


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_another_specimen_of_it_reads_what_is_true(path: Path, seed: int) -> None:
    """Zeros anywhere, whole turns off, play: none of it is seen from the joints."""
    robot = linked.read_robot(path)
    rig = Rig(str(path), truth=random_truth(robot, seed))
    rig.arm()
    move(rig, bent(rig))
    assert rig.loop.measured.position == pytest.approx(rig.truth, abs=0.02)  # play of its gears
    assert rig.truth == pytest.approx(bent(rig), abs=0.02)
    rig.close()


def test_a_table_that_was_written_anew_waits_for_a_restart(path: Path, tmp_path: Path) -> None:
    robot = linked.linked(tmp_path)
    other = linked.linked(tmp_path, rods=linked.table(13))
    assert "transmissions" in robot_difference(robot, other).restart
    assert robot_difference(robot, linked.linked(tmp_path)) == Difference({}, ())
    text = linked.ROBOT.replace("ank_in: {bus: leg, id: 5}", "ank_in: {bus: leg, id: 7}")
    assert robot_difference(robot, linked.linked(tmp_path, text)).restart == ("actuators.ank_in.id",)


def test_its_table_is_one_of_the_files_that_it_is_described_by(path: Path, tmp_path: Path) -> None:
    found = describe(Sources(mode="sim", robot=str(path), config=str(empty(tmp_path))))
    table = path.parent / "ankle.csv"
    assert found.files[str(table)] == fingerprint(table)


def empty(folder: Path) -> Path:
    settings = folder / "twind.yaml"
    settings.write_text("mode: sim\n")
    return settings


def test_limp_joints_beyond_their_table_are_known_and_keep_everybody_from_arming(rig: Rig) -> None:
    rig.connect()
    for actuator in (5, 6):  # both rods pushed 1.3 rad, where the table ends at 1.15
        rig.virtual["leg"].faults.hand(id=actuator, rad=1.3, speed=3.0)
    rig.seconds(1.0)
    state, pitch = rig.loop.measured, rig.names.index("ankle_pitch")
    assert state.heard.all()
    assert state.position[pitch] > linked.ankle(1.15, 1.15)[0]
    rig.lease()
    reply = rig.call(link.Arm)
    told = {finding["joint"] for finding in reply.parameters["findings"]}
    assert pitch in told
    assert rig.loop.state == "connected"
