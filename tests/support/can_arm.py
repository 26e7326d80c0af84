"""A daemon with the three-joint arm on CAN actuators of one family, under a fake clock."""

from pathlib import Path

from tests.support.daemon_rig import Rig

TEXT = """
format: twind-robot/1
name: arm
model: {{mjcf: {model}, base: stand}}
support: fixed
buses:
  main: {{kind: can, bitrate: 1000000}}
types:
  actuator: {{device: {device}, gains: {{kp: 20.0, kd: 1.0}}{keys}}}
defaults: {{type: actuator, bus: main}}
joints:
  shoulder_pitch: {{id: 1, limits_rad: [-1.5, 1.5]}}
  shoulder_roll: {{id: 2, limits_rad: [-0.1, 1.5]}}
  elbow: {{id: 3, limits_rad: [-2.0, 0.1]}}
gate: {{on_velocity: retime}}
poses:
  rest: {{}}
"""
KEYS = {"AK70-10": ", watchdog: unverified"}  # further keys of the type, by device


def can_arm(folder: Path, device: str) -> Rig:
    """A daemon in mode live on virtual actuators of `device`."""
    model = Path("docs/examples/arm/arm.xml").resolve()
    path = folder / f"{device}.yaml"
    path.write_text(TEXT.format(model=model, device=device, keys=KEYS.get(device, "")))
    return Rig(str(path))
