"""Faults of a calibration, planted in virtual servos: the daemon names each, and nothing moves.

Each of the fourteen is planted between a calibration and the next start, or in mid-run: no goal leaves that
would turn a shaft, and torque is off at the end. What no reading can show (a swapped servo whose zero is near
the old one, exchanged twins, a wrong sign) is for `twindctl calibrate prove`
(tests/calibration/test_proof_on_servos.py). Of files that are half written tests/config/test_atomic_save.py
tells; turns and seams are in test_calibration_turns.py.
"""

from dataclasses import replace
from typing import Any

import pytest

from tests.support.eeprom_access import calibrate, calibrated
from tests.support.miscalibrated_robots import KNEE, OPEN, PLAIN, Planted, floating, names_it, plant
from twind import link
from twind.config.robot_file import load_robot
from twind.robot.modes import RobotState
from twind.virtual.robot_ground_truth import JointGroundTruth

__all__ = ["floating", "plant"]

# ------------------------------------------------------------------- 1: offsets beyond what counts


@pytest.mark.parametrize("offset", [1025, -1025, 2900])
def test_an_offset_that_position_mode_ignores_is_refused_by_register_and_value(
    plant: Any, offset: int
) -> None:
    said = plant(PLAIN, JointGroundTruth(homing_offset=offset)).refused()
    assert names_it(said, "DEVICE_MISMATCH", KNEE, "homing_offset", str(offset), "1024")


def test_an_offset_that_fell_back_to_0_is_refused_with_what_it_was(plant: Any) -> None:
    before = JointGroundTruth(homing_offset=1000)
    found = JointGroundTruth(homing_offset=2900, forgets_offset=True)
    rig = plant(before, found)
    assert names_it(rig.refused(), "CALIB_MISMATCH", KNEE, "homing_offset is 0, was 1000")


# ------------------------------------------------------------------- 5: EEPROM under torque


def test_eeprom_is_not_written_under_torque_from_another_source(plant: Any) -> None:
    """The daemon cannot know it yet: the servo refuses, that is told, and nothing is half written."""
    rig = plant(PLAIN, PLAIN)
    rig.connect()
    calibrate(rig)
    servos = rig.virtual["main"].servos
    row = rig.names.index(KNEE)
    servos.torque(row, True)
    servos.invalidate_cache()
    before = servos.memory.raw[row, :64].copy()
    reply = rig.call(link.WriteRegister, bus="main", id=rig.id_of(KNEE), name="homing_offset", value=77)
    assert reply.error is not None and "writable only while torque is off" in str(reply.parameters), reply
    assert (servos.memory.raw[row, :64] == before).all()
    servos.torque(row, False)
    servos.invalidate_cache()
    calibrated(rig)


# ------------------------------------------------------------------- 6, 7: other servos than before


def test_a_swapped_servo_is_refused_by_its_tag(plant: Any) -> None:
    rig = plant(JointGroundTruth(tag=613), JointGroundTruth(tag=10))
    assert names_it(rig.refused(), "CALIB_MISMATCH", KNEE, "moving_threshold is 10", "613")


def test_a_swapped_servo_without_a_tag_is_refused_by_its_travel(plant: Any) -> None:
    """Same id, same model, same registers, another zero."""
    rig = plant(
        JointGroundTruth(zero_ticks=1700, registers=OPEN), JointGroundTruth(zero_ticks=700, registers=OPEN)
    )
    assert names_it(rig.refused(), "CALIB_MISMATCH", KNEE, "travel")


def test_exchanged_ids_are_refused_where_the_zeros_are_apart() -> None:
    left, right = (JointGroundTruth(zero_ticks=zero, registers=OPEN) for zero in (1700, 3600))
    apart = {KNEE: left, "r_knee": right}
    rig = Planted(apart, apart | {KNEE: replace(left, swapped_with="r_knee")})
    said = rig.refused()
    assert any(names_it(said, "CALIB_MISMATCH", joint, "travel") for joint in (KNEE, "r_knee"))
    rig.close()


# ------------------------------------------------------------------- 9: a reverse bit, and its offset


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (JointGroundTruth(drive_mode=1), "drive_mode is 1, was 0"),
        (JointGroundTruth(homing_offset=300), "homing_offset is 300, was 0"),
        (JointGroundTruth(drive_mode=1, homing_offset=300), "drive_mode is 1, was 0"),
        (JointGroundTruth(registers={"max_position_limit": 4000}), "max_position_limit is 4000"),
    ],
)
def test_settings_that_are_not_those_of_the_calibration_are_refused(
    plant: Any, found: JointGroundTruth, words: str
) -> None:
    assert names_it(plant(PLAIN, found).refused(), "CALIB_MISMATCH", KNEE, words)


def test_a_reversed_servo_that_was_calibrated_so_is_driven_as_it_was_calibrated(plant: Any) -> None:
    """Adopted, not assumed: its encoder counts against the file, and its reverse bit turns that."""
    sign = load_robot("h24").joints[load_robot("h24").names.index(KNEE)].sign
    truth = JointGroundTruth(drive_mode=1, homing_offset=300, sign=-sign, zero_ticks=-2000)
    rig = plant(truth, truth)
    rig.arm()
    row = rig.names.index(KNEE)
    rig.submit(rig.path(KNEE, [0.5], [1.0]))
    rig.seconds(1.6)
    assert rig.truth[row] == pytest.approx(0.5, abs=0.02)


# ------------------------------------------------------------------- 10: a reboot in mid-run


def test_a_servo_that_restarts_under_torque_is_unverified_and_gets_no_goal(plant: Any) -> None:
    rig = plant(PLAIN, PLAIN)
    rig.arm()
    row = rig.names.index(KNEE)
    servos = rig.virtual["main"].servos
    rig.submit(rig.path(KNEE, [0.4], [2.0]))
    rig.seconds(0.5)
    rig.virtual["main"].faults.brown_out(rig.id_of(KNEE))
    verified = []
    stood = float(rig.truth[row])
    for _ in range(200):
        rig.ticks(1)
        verified.append(bool(rig.loop.identity.verified.joints[row]))
    assert not all(verified) and verified[-1], "until it was asked anew"
    assert names_it(rig.reported_findings(), "SERVO_REBOOTED", KNEE, "restarted by itself")
    assert rig.loop.condition.state is RobotState.FAULT
    assert servos["torque_enable"][row] == 0
    assert rig.truth[row] == pytest.approx(stood, abs=0.003), "it never moves again by itself"
    rig.lease()
    assert rig.call(link.Disarm, ticks=800).error is None
    assert (rig.register("torque_enable") == 0).all()
    assert rig.call(link.Reset).error is None
    rig.lease()
    assert rig.call(link.Arm).error is None, "an operator may"


# ------------------------------------------------------------------- 11: another firmware


def test_another_firmware_is_warned_of_and_everything_read_anew(plant: Any) -> None:
    rig = plant(PLAIN, JointGroundTruth(firmware=48))
    rig.connect()
    words = "firmware is 48, was 47 when calibrated: prove it again"
    assert names_it(rig.reported_findings(), "CALIB_MISMATCH", KNEE, words)
    rig.arm()


# ------------------------------------------------------------------- 13: torque that nobody asked for


@pytest.mark.parametrize(("mode", "bit"), [(8, "bit 3"), (4, "bit 2")])
def test_a_drive_mode_bit_that_is_not_supported_is_refused_by_name(plant: Any, mode: int, bit: str) -> None:
    """3: a goal switches torque on. 2: profiles are times, and a goal is where it should be much later."""
    said = plant(PLAIN, JointGroundTruth(drive_mode=mode)).refused()
    assert names_it(said, "DEVICE_MISMATCH", KNEE, f"drive_mode (10) is {mode}", bit)


def test_torque_at_boot_is_refused_by_its_bit_and_left_as_it_was_found(plant: Any) -> None:
    rig = plant(PLAIN, JointGroundTruth(startup_configuration=1))
    rig.ticks(150)
    rig.call(link.AcquireLease)
    reply = rig.call(link.Arm)
    assert reply.error is not None
    said = rig.reported_findings(reply.parameters.get("findings", ()))
    assert names_it(said, "DEVICE_MISMATCH", KNEE, "startup_configuration (60) is 1", "bit 0")
    assert rig.energised == {KNEE}, "by itself, at its boot"
    assert rig.moved <= 1.0


# ------------------------------------------------------------------- 14: what a change of mode resets


def test_registers_reset_by_a_mode_change_are_restored_and_read_back_before_torque(plant: Any) -> None:
    rig = plant(PLAIN, PLAIN)
    rig.arm()
    row = rig.names.index("r_knee")
    servos = rig.virtual["main"].servos
    assert servos["position_p_gain"][row] == 1600
    assert rig.call(link.Disarm, ticks=800).error is None
    for mode in (4, 3):  # somebody tries something, and puts it back
        servos.registers.put("operating_mode", mode, row)
        servos.power.reset_mode(row)
    servos.invalidate_cache()
    assert servos["position_p_gain"][row] == 800, "as from the factory"
    rig.seconds(0.5)
    rig.lease()
    assert rig.call(link.Arm).error is None
    assert servos["position_p_gain"][row] == 1600
