"""The whole daemon with an arm of Y servos, under a fake clock."""

from pathlib import Path

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.derived_arm import serial_arm_of
from twind.config.robot_file import load_robot
from twind_drivers.bus import IdentifiedDevice

GAINS = "gains: {p: 6283185, i: 0, d: 9090}"


def test_an_arm_is_armed_moved_stopped_by_its_watchdogs_and_armed_again(
    make_rig: MakeRig, tmp_path: Path
) -> None:
    path = serial_arm_of(tmp_path, "dynamixel2", "YM070-210-R099", GAINS)
    rig: Rig = make_rig(path)
    rig.arm()
    ticket = rig.submit(rig.path("elbow", [-0.5, -0.5], [0.7, 1.2]))
    rig.seconds(1.5)
    assert [reply.error for reply in rig.replies(ticket)][:1] == [None], rig.replies(ticket)
    elbow = rig.names.index("elbow")
    assert abs(rig.truth[elbow] + 0.5) < 0.02
    rig.clock.sleep_until(rig.clock.now() + 2.0)  # nobody writes or reads: the daemon is dead
    servos = rig.virtual["main"]
    servos.advance(rig.clock.now())
    states = servos.truth(rig.clock.now())
    assert all(each["tripped"] and each["torque"] for each in states)
    assert abs(rig.truth[elbow] + 0.5) < 0.02
    rig.seconds(1.0)
    assert rig.events("WATCHDOG_TRIPPED"), [event.code for event in rig.events()]
    assert not rig.events("SERVO_ALERT")


def test_another_model_and_another_gear_ratio_are_refused(tmp_path: Path) -> None:
    robot = load_robot(serial_arm_of(tmp_path, "dynamixel2", "YM070-210-R099", GAINS))
    joint = robot.joints[0]
    fine = {"operating_mode": 3, "homing_offset": 0, "drive_mode": 0}
    geared = {"electronic_gearratio_numerator": 99, "electronic_gearratio_denominator": 1}

    def unfit(model: str, settings: dict[str, int]) -> str:
        return "; ".join(joint.type.unfit(joint, IdentifiedDevice(1, 4030, model, 1, settings)))

    assert unfit("YM070-210-R099", fine | geared) == ""
    assert "is YM080-230-R099" in unfit("YM080-230-R099", fine | geared)
    assert "electronic gear ratio (96, 100) is 1/1: write 99" in unfit(
        "YM070-210-R099", fine | dict.fromkeys(geared, 1)
    )
