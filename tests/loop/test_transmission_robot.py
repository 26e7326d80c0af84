"""A robot whose waist and ankle several actuators turn together: the whole daemon, and the virtual body."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import transmission_robot_file as linked
from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.config.config_files import ConfigSources, describe
from twind.config.file_changes import fingerprint
from twind.config.hot_changes import ConfigDifference, robot_difference
from twind.robot.arrays import Floats
from twind.robot.trajectory import Trajectory
from twind.virtual.robot_ground_truth import random_truth
from twind.virtual.virtual_robot_spec import buses

WAIST = ("waist_roll", "waist_yaw")
ANKLE = ("ankle_roll", "ankle_pitch")


class Body(Rig):
    """The rig with MuJoCo's body in place of joints without load."""

    def _virtual(self, bus: str, start: Mapping[str, float]) -> Any:
        self.served = getattr(self, "served", None) or buses(self.made, now=self.clock.now())
        return self.served[bus]

    @property
    def truth(self) -> Floats:
        self.advance_servos()
        whole = self.served["main"].servos.muscles.whole
        places = [whole.model.joint(joint.model_joint).qposadr[0] for joint in self.robot.joints]
        return np.array(whole.data.qpos[places])


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return linked.write(tmp_path_factory.mktemp("linked"))


@pytest.fixture
def rig(make_rig: MakeRig, path: Path) -> Rig:
    made: Rig = make_rig(str(path))
    return made


def bent(rig: Rig) -> Floats:
    return np.array([rig.robot.poses["bent"][name] for name in rig.names])


def move(rig: Rig, goal: Floats, seconds: float = 2.5) -> float:
    """All joints there; the largest difference on the way between what was read and what is true, rad."""
    rig.lease()
    both = np.stack([rig.loop.robot.measured.position, goal])
    path = Trajectory(np.array([0.0, seconds]), both, np.ones(len(goal), np.bool_))
    ticket = rig.submit(path)
    worst = 0.0
    for tick in range(round((seconds + 1.0) * 100)):
        rig.ticks(1)
        worst = max(worst, float(np.abs(rig.truth - rig.loop.robot.measured.position).max()))
        if tick % 50 == 0:
            rig.lease()
    assert rig.replies(ticket)[-1].parameters["verdict"]["refusals"] == []
    return worst


def test_a_robot_with_transmissions_arms_moves_reads_true_positions_and_disarms(rig: Rig) -> None:
    rig.arm()
    worst = move(rig, bent(rig))
    assert rig.truth == pytest.approx(bent(rig), abs=2e-3)
    assert worst < 0.02  # of a reading that is some ms old
    assert rig.loop.robot.measured.position == pytest.approx(rig.truth, abs=1e-3)
    assert rig.call(link.Disarm, ticks=2000).error is None
    assert rig.loop.condition.state == "connected"
    assert not rig.register("torque_enable").any()
    assert rig.truth == pytest.approx(np.zeros(5), abs=2e-3)


@pytest.mark.slow
def test_an_ankle_of_can_actuators_goes_where_it_is_sent_too(make_rig: MakeRig, tmp_path: Path) -> None:
    rig = make_rig(str(linked.write(tmp_path, linked.CAN_ROBOT)))
    rig.arm()
    move(rig, bent(rig))
    assert rig.truth == pytest.approx(bent(rig), abs=5e-3)
    assert rig.loop.robot.measured.position == pytest.approx(rig.truth, abs=2e-3)
    assert rig.call(link.Disarm, ticks=2000).error is None


@pytest.mark.slow
@pytest.mark.parametrize("text", [linked.ROBOT, linked.CAN_ROBOT], ids=["servos", "can"])
def test_a_body_behind_its_transmissions_goes_where_it_is_sent(
    make_rig: MakeRig, tmp_path: Path, text: str
) -> None:
    rig = make_rig(str(linked.write(tmp_path, text)), kind=Body)
    rig.arm()
    worst = move(rig, bent(rig))
    assert worst < 2e-3
    resolution = rig.loop.hardware.resolution
    assert (np.abs(rig.truth - rig.loop.robot.measured.position) <= resolution).all()
    sag = np.abs(rig.truth - bent(rig))
    assert sag[rig.names.index("knee")] < 0.1  # a position loop without I hangs a little
    assert np.delete(sag, rig.names.index("knee")).max() < 0.01


@pytest.mark.parametrize(("silent", "joints", "bus"), [(3, WAIST, "main"), (5, ANKLE, "leg")])
def test_an_actuator_without_replies_makes_all_its_joints_stale(
    rig: Rig, silent: int, joints: tuple[str, ...], bus: str
) -> None:
    rig.connect()
    rig.virtual[bus].faults.silence(silent)
    rig.seconds(0.3)
    state = rig.loop.robot.measured
    quiet = {name for name, heard in zip(rig.names, state.heard.tolist(), strict=True) if not heard}
    assert quiet == set(joints)
    for name in joints:
        assert state.age[rig.names.index(name)] > 0.2
    assert state.age[rig.names.index("knee")] < 0.05


def test_a_goal_out_of_reach_is_held_at_the_hard_limits_of_the_joints(rig: Rig) -> None:
    hard = rig.one.binding.limits
    near = rig.loop.hardware.reachable(np.full(5, 3.0))
    assert near[0] == hard.hard_upper[0]
    assert near[2] == hard.hard_upper[2]


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_another_individual_robot_of_the_type_reads_true_positions(
    make_rig: MakeRig, path: Path, seed: int
) -> None:
    """Zeros anywhere, whole turns off, play: none of it is seen from the joints."""
    robot = linked.read_robot(path)
    rig = make_rig(str(path), truth=random_truth(robot, seed))
    rig.arm()
    move(rig, bent(rig))
    assert rig.loop.robot.measured.position == pytest.approx(rig.truth, abs=0.02)  # play of its gears
    assert rig.truth == pytest.approx(bent(rig), abs=0.02)


def test_a_table_that_was_written_anew_waits_for_a_restart(path: Path, tmp_path: Path) -> None:
    robot = linked.linked(tmp_path)
    other = linked.linked(tmp_path, rods=linked.table(13))
    assert "transmissions" in robot_difference(robot, other).restart
    assert robot_difference(robot, linked.linked(tmp_path)) == ConfigDifference({}, ())
    text = linked.ROBOT.replace("ank_in: {bus: leg, id: 5}", "ank_in: {bus: leg, id: 7}")
    assert robot_difference(robot, linked.linked(tmp_path, text)).restart == ("actuators.ank_in.id",)


def test_the_linkage_table_is_among_the_described_files(path: Path, tmp_path: Path) -> None:
    found = describe(ConfigSources(mode="sim", robot=str(path), config=str(empty(tmp_path))))
    table = path.parent / "ankle.csv"
    assert found.files[str(table)] == fingerprint(table)


def empty(folder: Path) -> Path:
    settings = folder / "twind.yaml"
    settings.write_text("mode: sim\n")
    return settings


def test_limp_joints_beyond_their_table_have_positions_and_prevent_arming(rig: Rig) -> None:
    rig.connect()
    for actuator in (5, 6):  # both rods pushed 1.3 rad, where the table ends at 1.15
        rig.virtual["leg"].faults.hand(id=actuator, rad=1.3, speed=3.0)
    rig.seconds(1.0)
    state = rig.loop.robot.measured
    pitch = rig.names.index("ankle_pitch")
    assert state.heard.all()
    assert state.position[pitch] > linked.ankle(1.15, 1.15)[0]
    rig.lease()
    reply = rig.call(link.Arm)
    told = {finding["joint"] for finding in reply.parameters["findings"]}
    assert pitch in told
    assert rig.loop.condition.state == "connected"


def test_a_hot_motor_keeps_each_joint_that_it_turns_from_moving(rig: Rig) -> None:
    rig.arm()
    rig.virtual["main"].faults.heat(3, 66.0)  # waist_a, where waist_roll sits: slower, and not to begin anew
    rig.seconds(1.5)
    for joint, free in (("waist_roll", False), ("waist_yaw", False), ("knee", True)):
        rig.lease()
        ticket = rig.submit(
            rig.path(joint, [rig.loop.robot.measured.position[rig.names.index(joint)], 0.1], [0.0, 2.0])
        )
        rig.ticks(2)
        told = [(one["code"], one["joint"]) for one in rig.replies(ticket)[-1].parameters.get("findings", [])]
        assert told == ([] if free else [("THERMAL_HEADROOM", rig.names.index("waist_roll"))])


def test_a_blocked_motor_stops_each_of_its_joints_in_place(rig: Rig) -> None:
    rig.arm()
    rig.virtual["main"].faults.lock(3)
    rig.lease()
    rig.submit(
        Trajectory(
            np.array([0.0, 1.0]),
            np.stack([rig.loop.robot.measured.position, bent(rig)]),
            np.ones(5, np.bool_),
        )
    )
    rig.seconds(1.6)
    assert rig.loop.condition.state == "fault"
    goal = rig.loop.robot.written
    place = rig.loop.robot.measured.position
    for joint in WAIST:
        at = rig.names.index(joint)
        assert goal[at] == pytest.approx(place[at], abs=0.02), joint


@pytest.mark.parametrize(("frozen", "seat"), [(3, "waist_roll"), (1, "waist_yaw")])
def test_a_frozen_encoder_of_a_transmission_is_found(rig: Rig, frozen: int, seat: str) -> None:
    rig.arm()
    rig.virtual["main"].faults.freeze(frozen)
    rig.lease()
    rig.submit(rig.path("waist_yaw", [0.0, -0.4], [0.0, 1.5]))  # by both alike
    rig.seconds(1.0)
    told = [finding.joint for event in rig.events("SENSE_FROZEN") for finding in event.findings]
    assert told[:1] == [rig.names.index(seat)]
