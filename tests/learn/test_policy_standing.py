"""A policy on h24-standing, over the bus and through the gate: the whole daemon under a fake clock.

What is in the way of a policy here is what a robot has: servos and their quantised counts, the bus, the
loop's tick between reading and goal, joints and an IMU instead of the truth.
"""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.policy_files import constant, plain
from tests.support.standing_policy import CARD, bending
from tests.support.standing_rig import StandingRig, soft, truth
from twind.learn.policy.policy_file import NetworkLayer, Policy, load, save


def policy(folder: Path, layers: list[NetworkLayer]) -> Policy:
    save(folder / "policy.onnx", layers, *plain(CARD), CARD)
    return load(folder / "policy.onnx")


def test_the_loop_commands_exactly_the_target_of_the_policy(rig: StandingRig, tmp_path: Path) -> None:
    pilot = rig.pilots(policy(tmp_path, bending()))
    asked = []
    commanded = []
    errors = []

    def look(step: int) -> None:
        heard = rig.state_message()
        if step > 1:
            asked.append(pilot.shaper.target.copy())
            commanded.append(heard.goal.copy())
            told = rig.estimator.reading(heard)
            errors.append(told.base_velocity - truth(rig).base_velocity)

    assert rig.drive(4.0, look) is None
    assert not rig.refused and not rig.told and not pilot.figures.holds
    knee = rig.names.index("l_knee")
    assert np.ptp(np.array(asked)[:, knee]) > 0.2  # it moves
    # The goal of the tick that ends a period is its target, one tick after it was sent.
    assert np.abs(np.array(asked) - np.array(commanded)).max() < 1e-6
    assert np.abs(errors).max() < 0.02  # m/s, with counts and quantised velocities of the wire


def test_a_silent_imu_holds_and_ends_the_drive(rig: StandingRig, tmp_path: Path) -> None:
    rig.pilots(policy(tmp_path, bending()))
    assert rig.drive(1.0) is None
    assert rig.robot.imu is not None
    rig.virtual["main"].faults.silence(rig.robot.imu.id)
    before = rig.loop.executor.reference.position.copy()
    why = rig.drive(3.0)
    assert why is not None and "the IMU was read" in why
    assert np.abs(rig.loop.executor.reference.position - before).max() < 0.2  # braked, not on
    assert rig.loop.torque.armed and rig.loop.executor.motion == "holding"
    assert not rig.base()["held"] and rig.base()["position"][2] > 0.4


def test_a_short_silence_holds_and_goes_on(rig: StandingRig, tmp_path: Path) -> None:
    pilot = rig.pilots(policy(tmp_path, bending()))
    assert rig.robot.imu is not None
    imu = rig.robot.imu.id
    faults = rig.virtual["main"].faults
    steps = list[np.ndarray]()

    def silence(step: int) -> None:
        steps.append(rig.loop.executor.reference.position.copy())
        if step == 50:
            faults.silence(imu)
        if step == 60:
            faults.silence(imu, on=False)

    assert rig.drive(3.0, silence) is None
    assert pilot.figures.holds == 1 and pilot.holding is None and not rig.refused
    speed = np.abs(np.diff(np.array(steps), axis=0)) / 0.02
    assert speed.max() < 4.0 and np.abs(np.diff(speed, axis=0)).max() / 0.02 < 25.0  # no jump


@pytest.mark.parametrize("joint", ["l_knee", "head_yaw"])
def test_a_joint_with_a_stale_reading_causes_a_hold(rig: StandingRig, tmp_path: Path, joint: str) -> None:
    rig.pilots(policy(tmp_path, bending()))
    assert rig.drive(0.5) is None
    rig.virtual["main"].faults.silence(rig.robot.joints[rig.names.index(joint)].id)
    rig.drive(0.3)
    assert any(f"{joint} was read" in why for why in rig.told)


def test_a_policy_that_stops_sending_leaves_the_robot_holding_within_the_gate_bounds(
    rig: StandingRig, tmp_path: Path
) -> None:
    rig.pilots(policy(tmp_path, bending()))
    assert rig.drive(1.5) is None
    rig.seconds(0.09)  # 60 ms of the last setpoint, and the ticks that took and missed it
    assert rig.loop.executor.motion == "holding"
    rig.seconds(0.18)  # 0.25 s after the last setpoint
    assert not rig.loop.parts.lease.holds(rig.clock.now())
    rig.seconds(2.0)
    assert rig.loop.torque.armed and rig.base()["position"][2] > 0.4


# ------------------------------------------------------------------------------------------ what was learnt

SOFT = 500  # of its P gain of 1600: the pose alone does not keep it up
LEAN = -0.04  # of both ankle_pitch, always: 20 mrad
PATIENT = 30.0  # s


@pytest.fixture(scope="module")
def learnt(request: pytest.FixtureRequest) -> Policy:
    """Trained from scratch, in MuJoCo alone."""
    pytest.importorskip("stable_baselines3", reason="make extras EXTRAS=learn")
    from tests.support import trained_policy as trained

    return load(trained.policy(request.config))


@pytest.mark.campaign
def test_a_learnt_policy_stands_on_the_robot_and_is_never_refused(rig: StandingRig, learnt: Policy) -> None:
    pilot = rig.pilots(learnt)
    assert rig.drive(PATIENT) is None
    assert pilot.figures.steps == PATIENT * 50 and not rig.refused and not rig.told
    assert not rig.base()["held"] and pilot.figures.most_tilt < 20.0


@pytest.mark.campaign
def test_a_learnt_policy_stands_where_a_held_pose_falls(learnt: Policy, tmp_path: Path) -> None:
    """A constant lean does not fall there either: it is no proof of feedback."""
    stood = []
    lean = [LEAN * name.endswith("ankle_pitch") for name in CARD.joints]
    held, blind = (policy(tmp_path, constant(CARD, each)) for each in (0.0, lean))
    for driven, seconds in ((held, PATIENT), (learnt, PATIENT), (blind, 10.0)):
        with closing(StandingRig(soft(tmp_path, SOFT))) as rig:
            rig.arm()
            rig.pilots(driven)
            rig.seconds(1.05)  # the hands have just let go
            rig.lease()
            assert not rig.base_support.is_holding
            stood.append(rig.drive(seconds) is None)
            assert not rig.refused
    assert stood == [False, True, True]
