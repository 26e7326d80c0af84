"""A robot file bound to its model: every joint mapped or passive, limits the tightest there are."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.built_in_copy import change, copy_built_in
from tests.support.examples import examples
from twind.config.calibration_file import Calibration, JointCalibration, fitting
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.exceptions import InvalidInput
from twind.twin.binding import Binding, bind
from twind_drivers.bus import IdentifiedDevice

H24 = load_robot("h24")
SPLIT = load_robot("h24-split")
TICK = 2 * math.pi / 4096


def calibrated(robot: RobotFile, zero: int = 2048, low: int = 0, high: int = 4095) -> Calibration:
    registers = {"homing_offset": 0, "drive_mode": 0, "operating_mode": 3}
    registers |= {"min_position_limit": low, "max_position_limit": high}
    devices = {(j.bus, j.id): IdentifiedDevice(j.id, 1020, "XM430-W350", 46, registers) for j in robot.joints}
    zeros = dict.fromkeys(robot.names, zero)
    return fitting(robot, zeros, devices, created="2026-11-21T09:14:03Z", tool="twind")


def only(robot: RobotFile, name: str, **changes: object) -> RobotFile:
    return replace(robot, joints=tuple(replace(j, **changes) if j.name == name else j for j in robot.joints))


def model_of(tmp_path: Path, old: str, new: str, robot: RobotFile = H24) -> RobotFile:
    assert old in robot.mjcf
    path = tmp_path / "model.xml"
    path.write_text(robot.mjcf.replace(old, new))
    return replace(robot, mjcf_path=path, mjcf=path.read_text())


def refused(robot: RobotFile, calibration: Calibration | None = None) -> str:
    with pytest.raises(InvalidInput) as caught:
        bind(robot, calibration)
    return str(caught.value)


def test_every_joint_meets_its_address_by_name() -> None:
    binding = bind(H24, None)
    model = binding.model
    for place, joint in enumerate(H24.joints):
        number = model.joint(joint.model_joint).id
        assert binding.qpos[place] == model.jnt_qposadr[number]
        assert binding.dof[place] == model.jnt_dofadr[number]
        assert model.actuator(joint.name).trnid[0] == number
        assert binding.actuators[place] == model.actuator_ctrladr[model.actuator(joint.name).id]


def test_the_joint_order_is_that_of_the_robot_file() -> None:
    backwards = replace(H24, joints=H24.joints[::-1])
    binding = bind(backwards, None)
    assert binding.joint_map.names == H24.names[::-1]
    assert (binding.qpos == bind(H24, None).qpos[::-1]).all()
    assert binding.joint_map.buses[0].ids == tuple(range(1, 25))
    assert (binding.joint_map.buses[0].joints == np.arange(24)[::-1]).all()


@pytest.mark.parametrize(("support", "free"), [("gantry", False), ("fixed", False), ("free", True)])
def test_the_base_is_pinned_unless_it_is_free(support: str, free: bool) -> None:
    binding = bind(replace(H24, support=support), None)
    assert (binding.model.nv == 30) is free
    assert (binding.model.nv == 24) is not free
    assert binding.floating is free


def test_the_text_of_the_model_compiles_to_the_same_model() -> None:
    binding = bind(H24, None)
    again = mujoco.MjModel.from_xml_string(binding.mjcf)
    assert (again.nq, again.nu) == (24, 24)
    assert np.allclose(again.body_mass, binding.model.body_mass)
    assert np.allclose(again.jnt_range, binding.model.jnt_range)
    assert binding.model.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE


def test_two_buses_have_two_maps_with_ids_of_their_own() -> None:
    upper, lower = bind(SPLIT, calibrated(SPLIT)).joint_map.buses
    assert (upper.name, lower.name) == ("upper", "lower")
    assert upper.ids == lower.ids == tuple(range(1, 13))
    assert sorted([*upper.joints, *lower.joints]) == list(range(24))


def test_factors_are_signed_and_geared() -> None:
    binding = bind(only(H24, "r_knee", ratio=1.5, lower=-0.1, upper=2.1), None)
    bus = binding.joint_map.buses[0]
    place = H24.names.index("r_knee")
    assert bus.scale[place] == pytest.approx(-TICK / 1.5)
    assert bus.velocity_scale[place] == pytest.approx(-0.229 * 2 * math.pi / 60 / 1.5)
    assert bus.effort_scale[place] == pytest.approx(-1.5 * 1.78 * 0.00269)
    assert binding.limits.effort[place] == pytest.approx(1.5 * 1.78 * 2.3)


def test_an_unknown_torque_constant_makes_effort_unknown() -> None:
    kind = replace(H24.joints[0].type, torque_constant_nm_per_a=math.nan)
    binding = bind(only(H24, "head_yaw", type=kind), None)
    assert np.isnan(binding.joint_map.buses[0].effort_scale[0])
    assert np.isnan(binding.limits.effort[0])
    assert np.isfinite(binding.limits.effort[1:]).all()


def test_without_calibration_zero_is_mid_encoder_and_nothing_counts_as_calibrated() -> None:
    joint_map = bind(H24, None).joint_map
    assert (joint_map.buses[0].zero == 2048).all()
    assert not any(joint_map.calibrated)
    whole = calibrated(H24, 2000)
    partly = bind(H24, replace(whole, joints=whole.joints[1:]))
    assert partly.joint_map.calibrated == (False, *[True] * 23)
    assert list(partly.joint_map.buses[0].zero[:2]) == [2048, 2000]


# --------------------------------------------------------------------------------------------- limits


def knee(binding: Binding) -> tuple[float, float, float, float]:
    limits = binding.limits
    place = H24.names.index("l_knee")
    found = (limits.hard_lower, limits.lower, limits.upper, limits.hard_upper)
    return tuple(float(each[place]) for each in found)  # type: ignore[return-value]


def test_the_gate_accepts_the_robot_files_limits_and_the_hard_ones_are_beyond() -> None:
    assert knee(bind(H24, calibrated(H24))) == pytest.approx((-0.15, -0.1, 2.2, 2.25), abs=1e-9)


def with_knee(change: Callable[[JointCalibration], JointCalibration]) -> Binding:
    """Bind h24 with a changed calibration entry of its left knee."""
    calibration = calibrated(H24)
    joints = tuple(change(entry) if entry.name == "l_knee" else entry for entry in calibration.joints)
    return bind(H24, replace(calibration, joints=joints))


@pytest.mark.parametrize(
    ("sweep", "expected"),
    [
        ((-70, 1450), (-70 * TICK, -0.1, 2.2, 1450 * TICK)),
        ((-30, 1400), (-30 * TICK, -30 * TICK, 1400 * TICK, 1400 * TICK)),
    ],
)
def test_hard_limits_end_at_the_measured_travel_and_what_the_gate_accepts_within_it(
    sweep: tuple[int, int], expected: tuple[float, ...]
) -> None:
    ends = (2048 + sweep[0], 2048 + sweep[1])
    binding = with_knee(lambda entry: replace(entry, sweep_ticks=ends))
    assert knee(binding) == pytest.approx(expected, abs=1e-9)


def test_the_servos_own_limits_tighten_too() -> None:
    binding = with_knee(
        lambda entry: replace(entry, device=replace(entry.device, min_ticks=2019, max_ticks=3419))
    )
    hard_lower, lower, upper, hard_upper = knee(binding)
    place = H24.names.index("l_knee")
    assert (binding.joint_map.buses[0].lower[place], binding.joint_map.buses[0].upper[place]) == (2019, 3419)
    assert (hard_lower, lower) == pytest.approx((-29.499 * TICK,) * 2, abs=1e-9)
    assert (upper, hard_upper) == pytest.approx((1371.499 * TICK,) * 2, abs=1e-9)


def test_in_modes_of_many_turns_the_servos_own_limits_tighten_nothing() -> None:
    # e-manual, Min/Max Position Limit (48, 52): used in position control mode only
    free = replace(H24, joints=tuple(replace(joint, mode="extended_position") for joint in H24.joints))
    narrow = calibrated(H24, low=2019, high=2100)
    assert knee(bind(free, narrow)) == knee(bind(free, calibrated(H24)))
    (bus,) = bind(free, calibrated(H24, zero=-10_000, low=-12_048, high=-7_952)).joint_map.buses
    assert (bus.upper < -7_000).all()


def test_the_models_range_bounds_the_hard_limits(tmp_path: Path) -> None:
    robot = model_of(
        tmp_path,
        'name="l_knee" axis="0 1 0" range="-0.15 2.3"',
        'name="l_knee" axis="0 1 0" range="-0.12 2.21"',
    )
    assert knee(bind(robot, calibrated(H24))) == pytest.approx((-0.12, -0.1, 2.2, 2.21), abs=1e-9)


@examples(25)
@given(st.integers(1800, 2300), st.integers(0, 300), st.integers(3700, 4095))
def test_every_goal_that_the_limits_allow_is_a_count_that_the_servo_takes(
    zero: int, low: int, high: int
) -> None:
    try:
        binding = bind(H24, calibrated(H24, zero, low, high))
    except InvalidInput:
        return
    bus = binding.joint_map.buses[0]
    limits = binding.limits
    for bound in (limits.lower, limits.upper):
        ticks = np.rint(bus.zero + bound[bus.joints] / bus.scale)
        assert (ticks >= bus.lower).all()
        assert (ticks <= bus.upper).all()
    assert (bus.lower >= low).all()
    assert (bus.upper <= high).all()
    assert (limits.hard_lower <= limits.lower).all()
    assert (limits.lower < limits.upper).all()
    assert (limits.upper <= limits.hard_upper).all()
    assert (limits.lower >= [joint.lower for joint in H24.joints]).all()
    assert (limits.upper <= [joint.upper for joint in H24.joints]).all()


def test_a_zero_that_leaves_no_count_is_refused_with_what_to_do() -> None:
    message = refused(H24, calibrated(H24, 20_000))
    assert "no count is inside its limits" in message
    assert "remount the horn" in message


# -------------------------------------------------------------------------------------------- refusals


def test_a_range_in_degrees_that_was_meant_in_radians_is_recognised(tmp_path: Path) -> None:
    arm = copy_built_in("so101", tmp_path)
    change(tmp_path / "servos.xml", 'angle="radian"', 'angle="degree"')
    with pytest.raises(InvalidInput, match=r"so101.yaml:\d+:\d+: .*`<compiler angle=\"radian\"/>` missing"):
        bind(load_robot(str(arm)), None)


def test_files_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    assert "the model has no joint 'knee'" in refused(only(H24, "l_knee", model_joint="knee"))
    less = replace(H24, joints=H24.joints[1:])
    assert "model joint 'head_yaw' stands neither in `joints` nor in `passive`" in refused(less)
    bind(replace(less, passive=("head_yaw",)), None)
    assert "passive: the model has no joint 'tail'" in refused(replace(H24, passive=("tail",)))
    assert "no body 'hips'" in refused(replace(H24, base="hips"))
    assert "limits -0.1..2.4 rad are outside the model's range -0.15..2.3" in refused(
        only(H24, "l_knee", upper=2.4)
    )
    lines = H24.path.read_text().splitlines()
    number = next(
        place
        for place, line in enumerate(lines, 1)
        if line.lstrip().startswith("l_knee:") and "limits" in line
    )
    column = lines[number - 1].index("limits_rad: ") + len("limits_rad: ") + 1
    at = f"{H24.path}:{number}:{column}: joints.l_knee.limits_rad: "
    assert refused(only(H24, "l_knee", upper=2.4)).startswith(at)
    edited = replace(only(H24, "l_knee", upper=2.4), text_sha256="0" * 64)  # since it was read
    assert refused(edited).startswith(f"{H24.path}: joints.l_knee.limits_rad: ")
    pinned = model_of(tmp_path, '<freejoint name="base"/>', "")
    assert "support: free needs a free joint" in refused(replace(pinned, support="free"))
    bind(pinned, None)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<position name="l_knee" joint="l_knee"/>', "", "has 0 actuators, needs one"),
        (
            '<position name="l_knee" joint="l_knee"/>',
            '<motor name="l_knee" joint="l_knee"/>',
            "no position servo",
        ),
        (
            '<position name="l_knee" joint="l_knee"/>',
            '<position name="l_knee" joint="l_knee"/><position name="again" joint="l_knee"/>',
            "has 2 actuators",
        ),
        ('name="l_knee" axis', 'name="l_knee" type="slide" axis', "is no hinge"),
        ("<mujoco model", "<mujoko model", "model.xml: "),
        ('size="0.026"', 'size="0"', "must be positive"),
        ("</mujoco>", "", "model.xml: "),
    ],
)
def test_a_model_that_cannot_be_used_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert message in refused(model_of(tmp_path, old, new))


def test_a_joint_without_a_range_takes_its_limits_from_the_file(tmp_path: Path) -> None:
    robot = model_of(tmp_path, 'name="l_knee" axis="0 1 0" range="-0.15 2.3"', 'name="l_knee" axis="0 1 0"')
    robot = model_of(tmp_path, ' inheritrange="1"', "", robot)
    assert knee(bind(robot, calibrated(H24))) == pytest.approx((-0.15, -0.1, 2.2, 2.25), abs=1e-9)
