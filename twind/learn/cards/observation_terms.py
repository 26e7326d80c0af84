"""Terms that an observation can consist of, by the names that a card uses.

Each is a block of the values that a robot has now: the own observation (`task/observation_layout.py`) and
what `card_observer.py` adds to it.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class KnownTerm:
    """One term: its block of values, and what its entries are."""

    block: str
    meaning: str
    each: str = "entry"  # entry: all of the block; joint: one per joint; action: one per action


KNOWN: Mapping[str, KnownTerm] = {
    "base_angular_velocity": KnownTerm("gyro", "rad/s, base frame"),
    "linear_acceleration": KnownTerm("acceleration", "m/s², as an accelerometer reads, base frame"),
    "projected_gravity": KnownTerm("gravity", "direction of gravity, base frame; upright: 0 0 -1"),
    "base_linear_velocity": KnownTerm("base_velocity", "m/s, base frame; on a robot estimated from the legs"),
    "base_height": KnownTerm("height", "m, of the base above the lower sole"),
    "orientation": KnownTerm("orientation", "quaternion w x y z; yaw since the start, from the gyro"),
    "roll_pitch_yaw": KnownTerm("roll_pitch_yaw", "rad, about x, y, z in turn; yaw as in orientation"),
    "velocity_command": KnownTerm("command", "m/s forward, m/s left, rad/s"),
    "joint_position": KnownTerm("position", "rad, less the default pose", "joint"),
    "joint_velocity": KnownTerm("velocity", "rad/s", "joint"),
    "joint_target": KnownTerm("target", "rad, the target sent last", "joint"),
    "joint_error": KnownTerm("lag", "rad, the target sent last less the position", "joint"),
    "last_action": KnownTerm("actions", "the last action, with `age: 2` the one before it", "action"),
    "phase_sin": KnownTerm("phase_sin", "sine of each phase of `phase`"),
    "phase_cos": KnownTerm("phase_cos", "cosine of each phase of `phase`"),
    "foot_contact": KnownTerm("foot_contact", "left, right: 1 within 1 cm of the lower sole; estimated"),
    "sole_positions": KnownTerm("soles", "m, left and right, from the base, base frame"),
    "sole_velocities": KnownTerm("sole_velocities", "m/s, left and right, relative to the base"),
    "constant": KnownTerm("one", "`value`, `size` times: for what the robot does not have"),
}
