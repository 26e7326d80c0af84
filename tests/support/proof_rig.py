"""Loads of the h24 as its model has them, and what the judge of proofs says of them."""

from functools import cache

import numpy as np
from hypothesis import strategies as st

from twind.config.calibration_file import JointCalibration
from twind.config.robot_file import load_robot
from twind.robot.arrays import Floats
from twind_calibration.proving.expected_loads import ExpectedLoads, at_places, mirror
from twind_calibration.proving.proof_sweep import MeasuredLoads
from twind_calibration.proving.sign_proof import LoadVerdict, judge, slack
from twind_calibration.wiggling.posed_model import PosedModel
from twind_calibration.wiggling.state_trace import HoldMean, MoveHolds

H24 = load_robot("h24")
# N·m
LSB = 0.0048
FRICTION = 0.1
PLACES = np.linspace(-0.25, 0.25, 4)  # rad, around the pose
BASES = ("upright", "back", "left")
ANY = st.sampled_from([name for name in H24.names if not name.startswith("r_")])
NOISE = st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).map(np.array)
TORQUE = st.floats(0.61, 1.39)


@cache
def body() -> PosedModel:
    return PosedModel(H24)


def place(name: str) -> int:
    return H24.names.index(name)


def judged(
    base: str,
    name: str,
    *,
    wrong: bool = False,
    off: float = 0.0,
    stretch: float = 1.0,
    rubs: float = 0.05,
    noise: Floats | None = None,
    at: float = 0.0,
    entry: JointCalibration | None = None,
) -> LoadVerdict:
    """A joint whose zero is `off` (rad) and whose servo tells `stretch` of its torque, less friction.

    `at` (rad): around which it is taken through its places; the others stand at nought.
    """
    one = body()
    joint = place(name)
    one.lie(base)
    poses = at_places(np.zeros(len(H24.names)), joint, at + PLACES)
    true = poses.copy()
    true[:, joint] += off
    if wrong:
        loads = np.array([one.flipped(each, joint)[joint] for each in true])
    else:
        loads = np.array([one.torque(each)[joint] for each in true])
    rough = np.zeros(len(PLACES)) if noise is None else 0.98 * slack(FRICTION, LSB) * noise
    told = stretch * loads + rough
    expected = ExpectedLoads(one, poses, joint)
    found = expected.loads_with_wrong_sign(mirror(H24.joints[joint], entry))
    return judge(told + rubs, told - rubs, expected.right(), found, FRICTION, LSB)


def measured_by(loads: Floats, poses: Floats) -> MeasuredLoads:
    """Told loads (k, n) at told poses (k, n)."""
    nothing = HoldMean(poses[0], poses[0], loads[0])
    rubs = np.full_like(loads, 0.04)
    return MeasuredLoads(poses, loads, loads + rubs, loads - rubs, MoveHolds(nothing, nothing, nothing))
