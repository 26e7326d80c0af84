"""A calibration of h24, the devices that it fits, and its text."""

from twind.config.calibration_file import Calibration, dump_calibration, fitting, text_hash
from twind.config.robot_file import load_robot
from twind_drivers.bus import IdentifiedDevice

ROBOT = load_robot("h24")
SETTINGS = {
    "homing_offset": 0,
    "drive_mode": 0,
    "operating_mode": 3,
    "min_position_limit": 0,
    "max_position_limit": 4095,
    "startup_configuration": 0,
    "return_delay_time": 5,
}
DEVICES = {
    (joint.bus, joint.id): IdentifiedDevice(joint.id, 1020, "XM430-W350", 46, SETTINGS)
    for joint in ROBOT.joints
}


def made(zero: int = 2048) -> Calibration:
    zeros = {name: zero + place for place, name in enumerate(ROBOT.names)}
    return fitting(ROBOT, zeros, DEVICES, created="2026-11-21T09:14:03Z", tool="twind 0.1.0")


TEXT = dump_calibration(made())


def rehashed(text: str) -> str:
    """The same with a hash that fits: an edit by someone who knows how."""
    body = "\n".join(line for line in text.split("\n") if not line.startswith("sha256:"))
    return f'{body}sha256: "{text_hash(body)}"\n'


CALIBRATION = fitting(
    ROBOT, dict.fromkeys(ROBOT.names, 2048), DEVICES, created="2026-11-21T09:14:03Z", tool="twind"
)
KNEE = ROBOT.names.index("l_knee")
KEY = (ROBOT.joints[KNEE].bus, ROBOT.joints[KNEE].id)
