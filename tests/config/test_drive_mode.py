"""A robot whose joints have different operating modes: from its file to servos that move."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.support.daemon_rig import Rig
from tests.support.eeprom_access import calibrate, calibrated
from twind import link
from twind.config.robot_file import load_robot
from twind.robot.modes import RobotState
from twind_drivers.dynamixel.packet import sync_write

CAP = 855  # 2.3 A in counts of 2.69 mA
FLOATING = ("head_yaw", "l_knee")  # extended position
SOFT = ("l_elbow", "r_elbow")  # current-based position


@pytest.fixture
def mixed(tmp_path: Path) -> Iterator[Rig]:
    """h24 with three modes on its one bus."""
    built_in = load_robot("h24")
    text = built_in.path.read_text().replace("mjcf: h24.xml", f"mjcf: {built_in.mjcf_path}")
    for mode, names in (("extended_position", FLOATING), ("current_based_position", SOFT)):
        for name in names:
            head, _, rest = text.partition(f"  {name}:")
            text = f"{head}  {name}:{rest.replace('{', '{mode: ' + mode + ', ', 1)}"
    path = tmp_path / "mixed.yaml"
    path.write_text(text)
    rig = Rig(str(path))
    yield rig
    rig.close()


def row(rig: Rig, name: str) -> int:
    return rig.names.index(name)


def test_a_robot_of_three_modes_arms_moves_and_disarms(mixed: Rig) -> None:
    modes = mixed.register("operating_mode")
    assert [int(modes[row(mixed, name)]) for name in (*FLOATING, *SOFT, "waist_yaw")] == [4, 4, 5, 5, 3]
    mixed.arm()
    assert (mixed.register("torque_enable") == 1).all()
    current = mixed.register("goal_current")
    assert [int(current[row(mixed, name)]) for name in SOFT] == [CAP, CAP]
    before = mixed.truth
    for name, angle in (("l_knee", 0.5), ("l_elbow", -0.5), ("waist_yaw", 0.3)):
        mixed.lease()
        ticket = mixed.submit(mixed.path(name, [angle], [1.0]))
        mixed.seconds(1.6)
        assert mixed.replies(ticket)[0].error is None
        assert mixed.truth[row(mixed, name)] == pytest.approx(angle, abs=0.02)
    moved = {row(mixed, name) for name in ("l_knee", "l_elbow", "waist_yaw")}
    still = [place for place in range(24) if place not in moved]
    assert np.abs(mixed.truth - before)[still].max() < 0.01
    assert mixed.call(link.Disarm, ticks=800).error is None
    assert (mixed.register("torque_enable") == 0).all()


def test_a_servo_in_another_mode_than_its_joint_names_is_never_armed(mixed: Rig) -> None:
    servos = mixed.virtual["main"].servos
    servos.registers.put("operating_mode", 3, row(mixed, "l_knee"))
    servos.invalidate_cache()
    mixed.ticks(150)
    said = [event.message for event in mixed.events()]
    assert any(
        "id 16 on bus main: operating_mode (11) is 3, extended_position mode is 4" in each for each in said
    )
    mixed.call(link.AcquireLease)
    assert mixed.call(link.Arm).error is not None
    assert mixed.loop.condition.state is RobotState.IDENTIFYING
    assert (mixed.register("torque_enable") == 0).all()


def test_a_mode_written_through_the_daemon_is_reported_at_once(mixed: Rig) -> None:
    mixed.connect()
    calibrate(mixed)
    reply = mixed.call(link.WriteRegister, bus="main", id=2, name="operating_mode", value=4)
    assert reply.error is None
    mixed.ticks(80)
    calibrated(mixed)
    mixed.ticks(2)
    assert mixed.loop.condition.state is RobotState.IDENTIFYING
    assert any("id 2 on bus main: operating_mode (11) is 4" in event.message for event in mixed.events())
    calibrate(mixed)
    reply = mixed.call(link.WriteRegister, bus="main", id=2, name="operating_mode", value=3)
    assert reply.error is None
    calibrated(mixed)
    mixed.connect()


def test_a_write_to_an_uncompared_register_leaves_the_bus_connected(mixed: Rig) -> None:
    mixed.connect()
    assert mixed.call(link.WriteRegister, bus="main", id=2, name="led", value=1).error is None
    for _ in range(50):
        mixed.ticks(1)
        assert mixed.loop.condition.state is RobotState.CONNECTED


def test_a_servo_with_the_shadow_id_of_another_is_never_armed() -> None:
    """E-manual, X series, "Secondary(Shadow) ID (12)": it acts on packets for that id, without an answer."""
    rig = Rig()
    try:
        bus = rig.virtual["main"]
        shadow = row(rig, "l_knee")
        meant = row(rig, "waist_yaw")
        bus.servos.registers.put("secondary_shadow_id", rig.robot.joints[meant].id, shadow)
        bus.servos.invalidate_cache()
        rig.ticks(150)
        assert any("secondary_shadow_id (12) is" in event.message for event in rig.events())
        rig.call(link.AcquireLease)
        assert rig.call(link.Arm).error is not None
        assert rig.loop.condition.state is RobotState.IDENTIFYING
        assert (rig.register("torque_enable") == 0).all()
        lower = rig.register("min_position_limit")
        upper = rig.register("max_position_limit")
        goal = int(max(lower[[meant, shadow]]) + min(upper[[meant, shadow]])) // 2
        packet = sync_write(116, {rig.robot.joints[meant].id: goal.to_bytes(4, "little")})
        bus.receive(packet, rig.clock.now())
        rig.ticks(2)
        assert [int(rig.register("goal_position")[each]) for each in (meant, shadow)] == [goal, goal]
    finally:
        rig.close()


def test_a_mode_that_was_changed_after_identification_is_found_before_torque(mixed: Rig) -> None:
    mixed.connect()
    servos = mixed.virtual["main"].servos
    servos.registers.put("operating_mode", 4, row(mixed, "waist_yaw"))
    servos.invalidate_cache()
    mixed.call(link.AcquireLease)
    reply = mixed.call(link.Arm)
    assert "register 11" in str(reply.parameters)
    assert (mixed.register("torque_enable") == 0).all()
    assert mixed.loop.condition.state is RobotState.CONNECTED
