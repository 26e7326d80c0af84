"""Support of a freely standing robot until its legs carry it: h24-standing in MuJoCo."""

from math import hypot
from typing import Any

import mujoco
import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.exceptions import InvalidInput
from twind.twin.base_support import BY_ORDER, BY_TORQUE, NEVER, BaseSupport
from twind.twin.mujoco_physics import MujocoPhysics, body_of
from twind.virtual.virtual_server import ServoClock, VirtualBusServer
from twind_drivers.clock import FakeClock
from twind_drivers.virtual.servo_physics import DriveState

ROBOT = load_robot("h24-standing")
LEGS = np.array([name in ROBOT.legs for name in ROBOT.names])
STANDING = 0.444  # m, of the base in the rest pose: 0.455 m straight, less what bent knees take


def body(hold: str = BY_TORQUE) -> MujocoPhysics:
    return body_of(ROBOT, dict.fromkeys(ROBOT.names, 2048), hold=hold)


def support(muscles: MujocoPhysics) -> BaseSupport:
    assert muscles.crane is not None
    return muscles.crane


def torque(muscles: MujocoPhysics, on: Any) -> None:
    """Torque where `on` says, holding what is there."""
    one = np.ones(len(ROBOT.names))
    gains = dict.fromkeys(("i", "d", "velocity_p", "velocity_i"), 0.0 * one)
    caps = {"pwm_cap": 885 * one, "current_cap": 1193 * one, "supply": one}
    muscles.drive(DriveState(on=one * on > 0, mode=np.full(one.size, 3), p=1600 * one, **gains, **caps))
    muscles.set_goals(muscles.position.copy())


def height(muscles: MujocoPhysics) -> float:
    return float(support(muscles).place[2])


def tilt(muscles: MujocoPhysics) -> float:
    """Sine of half the angle by which the base leans."""
    return hypot(*support(muscles).place[4:6])


def run(muscles: MujocoPhysics, since: float, until: float, on: Any = None) -> None:
    if on is not None:
        torque(muscles, on)
    for step in range(round((until - since) * 100)):
        muscles.advance(since + (step + 1) / 100)


def test_a_limp_body_is_held_upright_on_the_floor_for_as_long_as_it_takes() -> None:
    muscles = body()
    run(muscles, 0.0, 20.0)
    assert height(muscles) == pytest.approx(STANDING, abs=0.001)
    assert tilt(muscles) < 1e-4
    assert support(muscles).is_holding


def test_a_robot_without_base_support_or_torque_falls() -> None:
    muscles = body(NEVER)
    run(muscles, 0.0, 3.0)
    assert height(muscles) < 0.3


def test_the_base_support_is_released_after_a_second_of_torque_and_the_robot_stands() -> None:
    muscles = body()
    run(muscles, 0.0, 0.9, on=1)
    assert support(muscles).is_holding
    run(muscles, 0.9, 1.2)
    assert not support(muscles).is_holding
    run(muscles, 1.2, 12.0)
    assert height(muscles) == pytest.approx(STANDING, abs=0.005)
    assert tilt(muscles) < 0.02
    sole = muscles.data.contact.geom[: muscles.data.ncon]
    assert len(sole), "the floor carries it"


def test_a_leg_servo_without_torque_keeps_the_base_support() -> None:
    muscles = body()
    on = np.ones(len(LEGS))
    on[ROBOT.names.index("l_knee")] = 0.0
    run(muscles, 0.0, 3.0, on=on)
    assert support(muscles).is_holding


def test_a_robot_whose_legs_go_limp_is_supported_in_place_and_released_again() -> None:
    muscles = body()
    run(muscles, 0.0, 2.0, on=1)
    before = height(muscles)
    run(muscles, 2.0, 5.0, on=0)
    assert support(muscles).is_holding and height(muscles) == pytest.approx(before, abs=0.003)
    run(muscles, 5.0, 8.0, on=1)
    assert not support(muscles).is_holding and height(muscles) == pytest.approx(STANDING, abs=0.01)


def test_a_standing_robot_with_one_limp_leg_is_not_supported() -> None:
    muscles = body()
    run(muscles, 0.0, 2.0, on=1)
    left = np.array([name.startswith("l_") for name in ROBOT.names]) & LEGS
    run(muscles, 2.0, 6.0, on=~left)
    assert not support(muscles).is_holding
    assert height(muscles) < 0.3, "it fell"


def test_by_order_alone_it_is_held_and_let_go() -> None:
    muscles = body(BY_ORDER)
    run(muscles, 0.0, 3.0, on=1)
    assert support(muscles).is_holding
    support(muscles).hold(False)
    run(muscles, 3.0, 4.0)
    assert not support(muscles).is_holding and height(muscles) == pytest.approx(STANDING, abs=0.005)
    run(muscles, 4.0, 7.0, on=0)
    assert height(muscles) < 0.3, "nobody catches it"
    support(muscles).hold()
    run(muscles, 7.0, 8.0)
    assert height(muscles) >= STANDING - 0.001 and tilt(muscles) < 1e-3, "lifted, upright"


@pytest.mark.parametrize("way", [(1.5, 0.0, 0.0), (0.0, -1.5, 0.0)])
def test_a_push_gives_the_whole_body_its_impulse(way: tuple[float, float, float]) -> None:
    """Measured in the air, where nothing else pushes sideways: change of momentum = impulse."""
    muscles = body(BY_ORDER)
    crane = support(muscles)
    torque(muscles, 1)
    muscles.data.qpos[2] += 2.0
    crane.let_go()
    crane.push(*way, seconds=0.05)
    muscles.advance(0.2)
    mujoco.mj_subtreeVel(muscles.model, muscles.data)
    mass = float(muscles.model.body_mass.sum())
    got = mass * muscles.data.subtree_linvel[muscles.model.body(ROBOT.base).id]
    assert got[:2] == pytest.approx(way[:2], rel=0.02, abs=0.02)


def test_a_small_push_is_borne_and_a_great_one_is_not() -> None:
    for impulse, falls in ((0.3, False), (6.0, True)):
        muscles = body()
        run(muscles, 0.0, 2.0, on=1)
        support(muscles).push(forward=impulse)
        run(muscles, 2.0, 5.0)
        assert (height(muscles) < 0.3) is falls


@pytest.mark.parametrize("wrong", [{"up": 101.0}, {"seconds": 3.0}, {"forward": float("nan")}])
def test_a_push_that_is_a_typing_error_is_refused(wrong: dict[str, float]) -> None:
    crane = support(body())
    with pytest.raises(ValueError, match=r"push: .* outside 0\.\.100 N·s over 0\.002\.\.2 s"):
        crane.push(**wrong)


def server(muscles: MujocoPhysics | None) -> VirtualBusServer:
    return VirtualBusServer(
        {}, {}, ServoClock(FakeClock()), lambda name, path: None, muscles and muscles.crane
    )


def test_orders_reach_the_body_without_a_bus() -> None:
    muscles = body()
    assert server(muscles).execute_fault_command({"fault": "hold", "on": False}) == {"ok": True}
    told = server(muscles).execute_fault_command({"query": "state"})["body"]
    assert told["held"] is False and told["position"][2] == pytest.approx(STANDING, abs=0.001)
    with pytest.raises(InvalidInput, match="push takes forward, left, up, seconds, not 'right'"):
        server(muscles).execute_fault_command({"fault": "push", "right": 1.0})


def test_a_hanging_or_lying_robot_has_no_base_support() -> None:
    hung = body_of(load_robot("h24"), dict.fromkeys(ROBOT.names, 2048))
    lying = body_of(ROBOT, dict.fromkeys(ROBOT.names, 2048), base="back")
    assert hung.crane is None and lying.crane is None and body().crane is not None
    with pytest.raises(InvalidInput, match="hold: no body stands here freely"):
        server(hung).execute_fault_command({"fault": "hold", "on": False})
    with pytest.raises(ValueError, match="'rope' is none of torque, order, never"):
        body("rope")
