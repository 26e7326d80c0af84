"""The torque that a path needs (TORQUE_INFEASIBLE): against potential energy and known loads."""

from dataclasses import replace
from math import nan
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.support.dynamics_rig import judge, pose, run
from tests.support.free_standing_h24 import free_h24
from twind.config.robot_file import load_robot
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode, Verdict
from twind.twin.binding import Binding, bind
from twind.twin.dynamics import FREE, PINNED, SHARE, Dynamics


@pytest.fixture(scope="module")
def pinned() -> Binding:
    return bind(load_robot("h24"), None)


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> Binding:
    return bind(load_robot(str(free_h24(tmp_path_factory.mktemp("free")))), None)


def able(binding: Binding, **effort: float) -> Binding:
    """The robot with other effort limits, N·m."""
    given = binding.limits.effort.copy()
    for name, value in effort.items():
        given[binding.joint_map.names.index(name)] = value
    return replace(binding, limits=replace(binding.limits, effort=given))


def strict(binding: Binding) -> Binding:
    robot = binding.robot
    return replace(binding, robot=replace(robot, gate=replace(robot.gate, on_torque="reject")))


def energy(binding: Binding, q: Floats) -> float:
    """Potential energy (J) of the pinned robot, straight from the bodies' places."""
    data = mujoco.MjData(binding.model)
    data.qpos[binding.qpos] = q
    mujoco.mj_kinematics(binding.model, data)
    return float(9.81 * (binding.model.body_mass * data.xipos[:, 2]).sum())


def test_torque_at_rest_is_the_slope_of_the_potential_energy(pinned: Binding) -> None:
    random = np.random.default_rng(5)
    dynamics = Dynamics(pinned)
    step = 1e-5
    for _ in range(5):
        q = random.uniform(pinned.limits.lower, pinned.limits.upper)
        slope = [
            (energy(pinned, q + step * unit) - energy(pinned, q - step * unit)) / (2 * step)
            for unit in np.eye(len(q))
        ]
        torque, _ = dynamics.sample(q, 0 * q, 0 * q)
        np.testing.assert_allclose(torque, slope, atol=1e-5)


def standing_energy(binding: Binding, q: Floats, foot: str) -> float:
    """Potential energy (J) with one foot nailed to the floor, from the bodies' places in its frame."""
    model = binding.model
    data = mujoco.MjData(model)
    data.qpos[binding.qpos] = q
    mujoco.mj_kinematics(model, data)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, foot)
    up = data.xmat[body].reshape(3, 3)[:, 2]  # the sole is square to z of the foot
    return float(9.81 * (model.body_mass * ((data.xipos - data.xpos[body]) @ up)).sum())


def test_on_one_foot_the_leg_carries_the_robot(free: Binding) -> None:
    q = pose(free, l_hip_pitch=-0.7, l_knee=1.4, l_ankle_pitch=-0.7, r_knee=0.4, r_shoulder_roll=-1.0)
    torque, _ = Dynamics(free).sample(q, 0 * q, 0 * q)
    step = 1e-5
    slope = [
        (standing_energy(free, q + step * unit, "r_foot") - standing_energy(free, q - step * unit, "r_foot"))
        / (2 * step)
        for unit in np.eye(len(q))
    ]
    np.testing.assert_allclose(torque, slope, atol=1e-5)
    knee = free.joint_map.names.index("r_knee")
    assert abs(torque[knee]) > 0.5  # and not the little that a hanging shank takes


def test_on_two_feet_the_waist_carries_and_the_legs_are_not_judged(free: Binding) -> None:
    q = pose(free, waist_pitch=0.4, l_hip_roll=0.0)
    torque, _ = Dynamics(free).sample(q, 0 * q, 0 * q)
    names = free.joint_map.names
    assert torque[names.index("waist_pitch")] < -0.5
    legs = [i for i, name in enumerate(names) if any(part in name for part in ("hip", "knee", "ankle"))]
    assert (torque[legs] == 0.0).all()


def test_a_path_within_what_the_joints_give_is_silent(pinned: Binding) -> None:
    assert judge(pinned, np.tile(pose(pinned, l_shoulder_roll=1.4), (10, 1))) == Verdict()


def test_an_excess_torque_is_reported_with_its_first_and_worst_time(pinned: Binding) -> None:
    out = pose(pinned, l_shoulder_roll=1.5)
    need = abs(Dynamics(pinned).sample(out, 0 * out, 0 * out)[0][3])
    path = np.array([pose(pinned, l_shoulder_roll=angle) for angle in np.linspace(0.0, 1.5, 31)])
    weak = able(pinned, l_shoulder_roll=need / 1.6)  # 0.8 of it is half of what is needed
    (found,) = judge(weak, path).warnings
    assert (found.code, found.joint) == (ReasonCode.TORQUE_INFEASIBLE, 3)
    assert found.value == pytest.approx(need) and found.bound == pytest.approx(need / 2)
    assert found.time is not None and 0.2 < found.time < 0.5  # sin(angle) is near one half
    assert "most at 1 s" in found.message and "standing still" not in found.message


@pytest.mark.parametrize(("share", "count"), [(SHARE * 1.0001, 0), (SHARE * 0.9999, 1)])
def test_the_bound_is_sharp(pinned: Binding, share: float, count: int) -> None:
    out = pose(pinned, l_shoulder_roll=1.5)
    need = abs(Dynamics(pinned).sample(out, 0 * out, 0 * out)[0][3])
    weak = able(pinned, l_shoulder_roll=need / SHARE * share / SHARE)
    assert len(judge(weak, np.tile(out, (3, 1))).warnings) == count


def test_acceleration_counts(pinned: Binding) -> None:
    acceleration = np.zeros((4, 24))
    acceleration[2, 2] = 300.0  # rad/s², of a shoulder
    quick = replace(pinned, limits=replace(pinned.limits, acceleration=np.full(24, 300.0)))
    (found,) = judge(quick, np.tile(pinned.rest, (4, 1)), acceleration).warnings
    assert (found.joint, found.time) == (2, pytest.approx(2 / 3))


def test_a_finite_peak_acceleration_gives_no_warning_and_a_nan_gives_one(pinned: Binding) -> None:
    acceleration = np.zeros((4, 24))
    acceleration[2, 2] = 300.0  # rad/s²: fifteen times its limit, so the path is slowed down, or refused
    assert judge(pinned, np.tile(pinned.rest, (4, 1)), acceleration) == Verdict()
    acceleration[2, 2] = nan
    assert judge(pinned, np.tile(pinned.rest, (4, 1)), acceleration).warnings


def test_a_robot_file_that_is_strict_refuses(pinned: Binding) -> None:
    weak = strict(able(pinned, l_shoulder_roll=0.1))
    path = np.array([pose(pinned, l_shoulder_roll=angle) for angle in np.linspace(0.0, 1.5, 31)])
    verdict = judge(weak, path)
    assert [found.code for found in verdict.refusals] == [
        ReasonCode.TORQUE_INFEASIBLE
    ] and not verdict.warnings


def test_a_joint_beyond_its_torque_bound_may_come_down_but_not_go_up(pinned: Binding) -> None:
    weak = strict(able(pinned, l_shoulder_roll=0.1))
    down = np.array([pose(pinned, l_shoulder_roll=angle) for angle in np.linspace(1.0, 0.0, 31)])
    verdict = judge(weak, down)
    assert verdict.accepted and "standing still at the start" in verdict.warnings[0].message
    up = np.array([pose(pinned, l_shoulder_roll=angle) for angle in np.linspace(1.0, 1.5, 31)])
    assert not judge(weak, up).accepted


def test_an_unknown_limit_is_not_judged_but_refuses_where_the_file_is_strict(pinned: Binding) -> None:
    unknown = able(pinned, l_shoulder_roll=nan)
    still = np.tile(pinned.rest, (3, 1))
    assert judge(unknown, still) == Verdict()
    (found,) = judge(strict(unknown), still).refusals
    assert (found.code, found.joint) == (ReasonCode.TORQUE_INFEASIBLE, 3)


def test_numbers_that_are_none_are_too_much(pinned: Binding) -> None:
    path = np.tile(pinned.rest, (3, 1))
    path[1, 3] = nan
    assert 3 in [found.joint for found in judge(pinned, path).warnings]


def test_no_samples_are_no_findings(pinned: Binding, free: Binding) -> None:
    for binding in (pinned, free):
        assert judge(binding, np.zeros((0, 24))) == Verdict()


def test_the_work_comes_in_slices(pinned: Binding, free: Binding) -> None:
    for binding, most in ((pinned, PINNED), (free, FREE)):
        rows = np.tile(binding.rest, (2 * most + 1, 1))
        verdict, slices = run(Dynamics(binding).judging(np.arange(len(rows)), rows, 0 * rows, 0 * rows))
        assert slices == 3 and verdict == Verdict()


def test_judging_leaves_the_shared_model_alone(pinned: Binding) -> None:
    before = pinned.model.opt.disableflags
    judge(pinned, np.tile(pinned.rest, (3, 1)))
    assert pinned.model.opt.disableflags == before


def test_the_free_robot_stands_with_its_file(tmp_path: Path) -> None:
    robot = load_robot(str(free_h24(tmp_path, was="on_position: reject", now="on_torque: reject")))
    assert robot.support == "free" and robot.gate.on_torque == "reject"
