"""The observer finds a torque from outside where the plant is as its model says."""

from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.contact_rig import identified
from tests.support.daemon_rig import known_robot
from twind.robot.arrays import Floats
from twind.robot.joint_state import JointState
from twind.twin.binding import bind
from twind.twin.simulation import Simulation
from twind.twin.torque_observer import ExternalTorqueObserver, limbs, observer_of

PERIOD = 0.01
H24 = known_robot("h24")
SO101 = known_robot("so101")
ARM = bind(identified(SO101, dict.fromkeys(SO101.names, 0.0)), None)
BINDING = bind(identified(H24, dict.fromkeys(H24.names, 0.0)), None)


def moved(observer: ExternalTorqueObserver, pressed: Floats, seconds: float, swing: float) -> None:
    """Let the simulation of the model swing all joints while `pressed` (n,), N·m, acts on them."""
    simulation = Simulation(BINDING, PERIOD)
    simulation.data.qfrc_applied[BINDING.dof] = pressed
    simulation.model.dof_frictionloss[:] = 0.0
    for tick in range(round(seconds / PERIOD)):
        simulation.step(BINDING.rest + swing * np.sin(2.0 * tick * PERIOD))
        observer.update(simulation.state(tick * PERIOD), held=False)


@settings(max_examples=8, deadline=None)
@given(
    torque=st.floats(0.5, 2.0),
    sign=st.sampled_from([-1.0, 1.0]),
    joint=st.integers(0, len(H24.names) - 1),
    swing=st.sampled_from([0.0, 0.1]),
)
def test_estimate_converges_to_the_applied_torque(
    torque: float, sign: float, joint: int, swing: float
) -> None:
    observer = ExternalTorqueObserver(BINDING, PERIOD)
    pressed = np.zeros(len(H24.names))
    pressed[joint] = sign * torque
    moved(observer, pressed, 1.5, swing)
    assert observer.external is not None
    assert observer.external.torque == pytest.approx(pressed, abs=0.06)


def test_robot_without_identified_model_or_on_its_feet_has_no_observer() -> None:
    assert observer_of(bind(H24, None), PERIOD) is None
    free = replace(identified(H24, {}), support="free")
    assert observer_of(bind(free, None), PERIOD) is None


def test_joint_without_effort_and_silent_joint_leave_no_estimate() -> None:
    observer = ExternalTorqueObserver(BINDING, PERIOD)
    moved(observer, np.zeros(len(H24.names)), 0.1, 0.0)
    simulation = Simulation(BINDING, PERIOD)
    for tick, changes in enumerate(({"effort": np.full(24, np.nan)}, {"heard": np.zeros(24, np.bool_)})):
        state: JointState = simulation.state(0.1 + tick * PERIOD)
        observer.update(replace(state, **changes), held=False)
        assert observer.external is None


@pytest.mark.parametrize("pause", [PERIOD, 60.0])
def test_after_a_gap_the_estimate_is_unknown_then_unbiased(pause: float) -> None:
    observer = ExternalTorqueObserver(BINDING, PERIOD)
    pressed = np.zeros(len(H24.names))
    pressed[H24.names.index("r_elbow")] = 2.0
    moved(observer, pressed, 1.0, 0.0)
    simulation = Simulation(BINDING, PERIOD)
    at_rest = simulation.state(1.0)
    if pause == PERIOD:
        observer.update(replace(at_rest, heard=np.zeros(24, np.bool_)), held=False)
    found = []
    for tick in range(10):
        simulation.step(BINDING.rest)
        observer.update(replace(simulation.state(1.0 + pause + tick * PERIOD)), held=False)
        found.append(observer.external)
    assert found[:2] == [None, None]
    assert all(one is None or np.abs(one.torque).max() < 0.3 for one in found)
    assert found[-1] is not None


def test_gaps_add_no_noise_to_a_steady_torque() -> None:
    """The hold of a contact rests on torque less its deviation."""
    observer = ExternalTorqueObserver(BINDING, PERIOD)
    simulation = Simulation(BINDING, PERIOD)
    simulation.data.qfrc_applied[BINDING.dof[H24.names.index("r_elbow")]] = 2.5
    simulation.model.dof_frictionloss[:] = 0.0
    for tick in range(2000):
        simulation.step(BINDING.rest)
        heard = np.full(24, tick % 5 != 0)
        observer.update(replace(simulation.state(tick * PERIOD), heard=heard), held=False)
    assert observer.external is not None
    assert observer.external.deviation.max() < 0.1


def test_a_limp_servo_without_current_has_no_torque_of_its_goal() -> None:
    limp = np.array([name == "elbow_flex" for name in SO101.names])
    found = []
    for far in (0.0, 0.5):
        observer = ExternalTorqueObserver(ARM, PERIOD)
        for state, goal in swung(Simulation(ARM, PERIOD), 0.2, 0.0):
            observer.update(state, held=True, goal=goal + far * limp, limp=limp)
        assert observer.external is not None
        found.append(observer.external.torque)
    assert found[1] == pytest.approx(found[0], abs=1e-9)


@settings(max_examples=8, deadline=None)
@given(
    torque=st.floats(-0.5, 0.5),
    joint=st.integers(0, len(SO101.names) - 1),
    swing=st.sampled_from([0.0, 0.1]),
)
def test_a_servo_without_current_is_estimated_from_its_goal(torque: float, joint: int, swing: float) -> None:
    observer = ExternalTorqueObserver(ARM, PERIOD)
    simulation = Simulation(ARM, PERIOD)
    simulation.model.dof_frictionloss[:] = 0.0
    simulation.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)  # it rests on its stops
    pressed = np.zeros(len(SO101.names))
    pressed[joint] = torque
    simulation.data.qfrc_applied[ARM.dof] = pressed
    for state, goal in swung(simulation, 1.5, swing):
        observer.update(state, held=True, goal=goal)
    assert observer.external is not None
    assert observer.external.torque == pytest.approx(pressed, abs=0.06)


def test_a_servo_without_current_needs_torque_and_a_stiffness_without_integral_gain() -> None:
    unknown = np.full(len(SO101.names), np.nan)
    soft = replace(ARM, ratings=replace(ARM.ratings, stiffness=unknown))
    kind = SO101.joints[1].type
    winding = kind.with_gains({**dict.fromkeys(kind.gain_limits, 0), "p": 32, "i": 4})
    joints = tuple(replace(joint, type=winding) for joint in SO101.joints)
    winds = replace(ARM, robot=replace(ARM.robot, joints=joints))
    for binding, held in ((ARM, True), (ARM, False), (soft, True), (winds, True)):
        observer = ExternalTorqueObserver(binding, PERIOD)
        for state, goal in swung(Simulation(ARM, PERIOD), 0.1, 0.0):
            observer.update(state, held=held, goal=goal)
        assert (observer.external is not None) == (binding is ARM and held)


def swung(simulation: Simulation, seconds: float, swing: float) -> Iterator[tuple[JointState, Floats]]:
    """Yield the states of an arm without measured effort, and the goal before each."""
    unknown = np.full(len(SO101.names), np.nan)
    for tick in range(round(seconds / PERIOD)):
        goal = ARM.rest + swing * np.sin(2.0 * tick * PERIOD)
        simulation.step(goal)
        yield replace(simulation.state(tick * PERIOD), effort=unknown), goal


def test_limb_of_a_joint_is_the_body_where_its_chain_begins() -> None:
    found = dict(zip(H24.names, limbs(BINDING), strict=True))
    assert found["l_elbow"] == found["l_shoulder_pitch"] != found["r_elbow"]
