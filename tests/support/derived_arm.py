"""Robot files of the three-joint arm with other servos."""

from pathlib import Path

TEXT = """
format: twind-robot/1
name: arm
model: {{mjcf: {model}, base: stand}}
support: fixed
buses:
  main: {{kind: {kind}, baud: 1000000}}
types:
  servo: {{device: {device}, return_delay_us: 0, {keys}}}
defaults: {{type: servo, bus: main}}
joints:
  shoulder_pitch: {{id: 1, limits_rad: [-1.5, 1.5]}}
  shoulder_roll: {{id: 2, limits_rad: [-0.1, 1.5]}}
  elbow: {{id: 3, limits_rad: [-2.0, 0.1]}}
gate: {{on_velocity: retime}}
poses:
  rest: {{}}
"""


def arm_of(folder: Path, kind: str, device: str, keys: str) -> str:
    """Write the robot file of an arm of `device`; `keys`: further ones of its type. Return its path."""
    model = Path("docs/examples/arm/arm.xml").resolve()
    path = folder / f"{device}.yaml"
    path.write_text(TEXT.format(model=model, kind=kind, device=device, keys=keys))
    return str(path)
