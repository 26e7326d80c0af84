"""Robot files of the three-joint arm with other devices, and daemons on them."""

from pathlib import Path

from tests.support.daemon_rig import Rig

MODEL = Path(__file__).resolve().parents[2] / "docs" / "examples" / "arm" / "arm.xml"
TEXT = """
format: twind-robot/1
name: {name}
model: {{mjcf: {model}, base: stand}}
support: fixed
buses:
  main: {bus}
types:
  device: {{device: {device}}}
defaults: {{type: device, bus: main}}
joints:
  shoulder_pitch: {{id: 1, limits_rad: [-1.5, 1.5]}}
  shoulder_roll: {{id: 2, limits_rad: [-0.1, 1.5]}}
  elbow: {{id: 3, limits_rad: [-2.0, 0.1]}}
gate: {{on_velocity: retime}}
poses:
  rest: {{}}
"""
UNWATCHED = frozenset({"AK70-10"})  # CAN devices without a watchdog that can be read


def arm_of(folder: Path, bus: str, device: str, name: str = "arm") -> str:
    """Write the robot file of an arm and return its path.

    `bus`: keys of its bus; `device`: the model and further keys of its type; `name` of robot and file.
    """
    path = folder / f"{name}.yaml"
    path.write_text(TEXT.format(name=name, model=MODEL, bus=bus, device=device), encoding="utf-8")
    return str(path)


def serial_arm_of(folder: Path, kind: str, device: str, keys: str) -> str:
    """Write the robot file of an arm of serial servos and return its path; `keys`: further ones."""
    return arm_of(folder, f"{{kind: {kind}, baud: 1000000}}", f"{device}, return_delay_us: 0, {keys}")


def can_arm(folder: Path, device: str) -> Rig:
    """Return a daemon in mode live on virtual CAN actuators of `device`."""
    watchdog = ", watchdog: unverified" if device in UNWATCHED else ""
    keys = f"{device}, gains: {{kp: 20.0, kd: 1.0}}{watchdog}"
    return Rig(arm_of(folder, "{kind: can, bitrate: 1000000}", keys))
