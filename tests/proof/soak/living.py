"""Robots that can live a long life: the shipped ones, the examples, and arms of families that have neither.

Of each robot two ends between which its joints may go, in any combination, without two bodies coming near.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.proof.faults.robot import CLEAR
from tests.support.daemon_rig import Rig
from tests.support.derived_arm import arm_of
from twind.robot.arrays import Floats
from twind.twin.collision_model import CollisionModel

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = ROOT / "docs" / "examples"
STROKE = 1.0  # rad, the most of a joint
SAMPLES = 150  # combinations of joints that are looked at
SHARES = (1.0, 0.6, 0.35, 0.2, 0.1, 0.0)  # of its room that a joint is given, the most that is clear
MARGIN = 0.05  # rad that a joint keeps from its limits
CAN = "gains: {kp: 60.0, kd: 2.0}, velocity_limit_rad_s: 4.0, acceleration_limit_rad_s2: 20.0"
# Arms of three joints with devices that no shipped robot has: keys of the bus, device with further keys.
ARMS = {
    "arm-robstride": (
        "{kind: can}",
        f"RS02, {CAN}, watchdog: device, ranges: {{position_rad: 12.57, velocity_rad_s: 33, torque_nm: 20}}",
    ),
    "arm-cubemars": (
        "{kind: can}",
        f"AK80-9, {CAN}, watchdog: unverified, "
        "ranges: {position_rad: 12.5, velocity_rad_s: 50, torque_nm: 18}",
    ),
    "arm-odrive": (
        "{kind: can}",
        f"ODrive, {CAN}, watchdog: unverified, "
        "ranges: {position_rad: 12.5, velocity_rad_s: 30, torque_nm: 10}",
    ),
    "arm-unwatched": (
        "{kind: dynamixel2_unwatched, baud: 1000000}",
        "XL320, return_delay_us: 0, watchdog: none",
    ),
}
# In the order of seeds: neighbours are of different families.
ROBOTS = (
    *("h24", "so101", "h24-mixed", "darwin", "koch", "arm-robstride", "h24-standing", "biped14"),
    *("arm-unwatched", "h24-split", "arm-odrive", "quadruped12", "pan-tilt", "nine", "arm-cubemars"),
    *("so101-leader", "arm"),
)


def robot_of(seed: int) -> str:
    """The robot of a seed."""
    return ROBOTS[seed % len(ROBOTS)]


def robot_file(name: str, folder: Path) -> str:
    """The name or path that `Rig` accepts for this robot; a file that is missing is written into `folder`."""
    if name in ARMS:
        return arm_of(folder, *ARMS[name], name)
    if name == "h24-standing":  # as shipped, and its falls are detected
        shipped = ROOT / "twind" / "robots"
        text = (shipped / f"{name}.yaml").read_text(encoding="utf-8")
        for relative in ("mjcf: ", "motions: "):
            text = text.replace(relative, f"{relative}{shipped}/")
        return _written(folder / f"{name}.yaml", text + "\nfall: {reaction: hold}\n")
    example = EXAMPLES / name / f"{name}.yaml"
    return str(example) if example.exists() else name


def _written(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def ends_of(rig: Rig) -> tuple[Floats, Floats]:
    """(n,) the rest pose and the other end of each joint, rad; every combination of both is clear of bodies.

    From a table, or as far as the model shows it; what is near another in the rest pose is left out.
    """
    binding = rig.one.binding
    rest = binding.rest
    if set(rig.names) <= set(CLEAR) and not rest.any():
        return rest, np.array([CLEAR[name] for name in rig.names])
    bodies = CollisionModel(binding)
    near = bodies.block + bodies.band
    judged = bodies.distances(rest[None], bodies.boxes)[0] > near
    limits = binding.limits
    random = np.random.default_rng(0)
    share = random.random((SAMPLES, len(rest)))
    share = np.where(random.random(share.shape) < 0.6, np.rint(share), share)
    stroke = np.zeros(len(rest))
    for joint in range(len(rest)):
        room = np.array(
            [limits.lower[joint] + MARGIN - rest[joint], limits.upper[joint] - MARGIN - rest[joint]]
        )
        room = np.clip(0.7 * room, (-STROKE, 0.0), (0.0, STROKE))
        for stroke[joint] in sorted(np.outer(SHARES, room).ravel(), key=abs, reverse=True):
            gaps = bodies.distances(rest + share * stroke, bodies.boxes)[:, judged]
            if (gaps > near[judged]).all():
                break
    return rest, rest + stroke
