"""Expected loads at given poses: joint as described, with the wrong sign, or exchanged with another.

The twin's model, base held as the person says; poses alone, no contact. Feeds `judge`, knows no robot.
"""

from collections.abc import Callable

import numpy as np

from twind.config.calibration_file import JointCalibration
from twind.config.counts import angle_of
from twind.config.robot_spec import JointSpec
from twind.robot.arrays import Floats
from twind_calibration.proving.sign_proof import (
    ASKED,
    CLOSE,
    GROSS,
    LoadPrediction,
    WrongSignLoads,
    foresee,
    refined,
    slack,
)
from twind_calibration.wiggling.posed_model import PosedModel

Mirror = tuple[float, float]  # rad, least and most that true and told angle add up to
STEP = float(CLOSE[1] - CLOSE[0])  # rad: near enough to each other that loads between them are straight lines


def mirror(joint: JointSpec, entry: JointCalibration | None) -> Mirror:
    """Return the bounds of the sum of true and reported angle for a wrong sign, by the travel (rad).

    Each end of the swept travel lay where the other one is described to be: at a stop, or at a limit where
    the stop is not described. Not calibrated: as if it had been swept from end to end.
    """
    ends = [
        joint.lower if joint.stops.lower is None else joint.stops.lower,
        joint.upper if joint.stops.upper is None else joint.stops.upper,
    ]
    told = ends
    if entry is not None:
        told = sorted(angle_of(joint, entry.zero_ticks, ticks) for ticks in entry.sweep_ticks)
    sums = sorted((ends[0] + told[1], ends[1] + told[0]))
    return sums[0], sums[1]


def offsets(sums: Mirror, step: float = STEP) -> Floats:
    """Return the zero errors (rad, ascending) to try with a wrong sign, to 5 degrees beyond each bound."""
    first = -sums[1] - GROSS
    last = -sums[0] + GROSS
    return np.linspace(first, last, max(2, 1 + int(np.ceil((last - first) / step))))


STRAIN = 0.5  # of what a joint can give: to hold more than that for long heats it
FEW: Floats = CLOSE[[0, len(CLOSE) // 2, -1]]  # enough to plan by


class ExpectedLoads:
    """Loads of one joint (place in joint order) at poses (k, n), rad, as the servos report them."""

    def __init__(self, body: PosedModel, poses: Floats, joint: int) -> None:
        self._body = body
        self._poses = poses
        self._joint = joint

    def right(self, zeros: Floats = ASKED) -> Floats:
        """(d, k) N·m, rows for errors of the joint's zero between those of `zeros`."""
        return self._family(zeros, self._body.torque)

    def loads_with_wrong_sign(
        self, sums: Mirror, zeros: Floats = CLOSE, step: float = STEP
    ) -> WrongSignLoads:
        """Likewise, its sign wrong; `sums` and `step` (rad) as in `mirror`."""
        return WrongSignLoads(self._reversed(zeros), self._reversed(offsets(sums, step)))

    def exchanged(self, other: int, zeros: Floats = CLOSE) -> Floats:
        """Likewise, its servo and that of joint `other` in each other's place."""
        return self._family(zeros, lambda pose: self._body.exchanged(pose, self._joint, other))

    def bent(self, other: int, zeros: Floats = CLOSE) -> Floats:
        """Likewise, the sign of joint `other` wrong, which stands where it is not told to be."""
        return self._family(zeros, lambda pose: self._body.flipped(pose, other))

    def all(self) -> Floats:
        """(k, n) of every joint, as described."""
        return np.array([self._body.torque(pose) for pose in self._poses])

    def all_turned(self) -> Floats:
        """Likewise, the sign of this one wrong."""
        return np.array([self._body.flipped(pose, self._joint) for pose in self._poses])

    def all_exchanged(self, other: int) -> Floats:
        """Likewise, the servo of joint `other` in this one's place."""
        return np.array([self._body.exchanged(pose, self._joint, other) for pose in self._poses])

    def _reversed(self, zeros: Floats) -> Floats:
        return self._family(zeros, lambda pose: self._body.flipped(pose, self._joint))

    def _family(self, zeros: Floats, own: Callable[[Floats], Floats]) -> Floats:
        rows = np.empty((len(zeros), len(self._poses)))
        for row, zero in enumerate(zeros):
            for column, pose in enumerate(self._poses):
                shifted = pose.copy()
                shifted[self._joint] += zero
                rows[row, column] = own(shifted)[self._joint]
        return refined(rows)


def at_places(pose: Floats, joint: int, places: Floats) -> Floats:
    """Poses (k, n): one joint at each of its places (k,), the others as in `pose`."""
    poses = np.tile(pose, (len(places), 1))
    poses[:, joint] = places
    return poses


def look_ahead(
    body: PosedModel,
    pose: Floats,
    joint: int,
    places: Floats,
    friction: float,
    entry: JointCalibration | None = None,
) -> LoadPrediction:
    """Predict the loads of a joint that is moved to these places (rad) from this pose.

    `entry`: its calibration; None: as if it had been swept from end to end.
    """
    spec = body.robot.joints[joint]
    expected = ExpectedLoads(body, at_places(pose, joint, places), joint)
    room = slack(friction, spec.ratio * spec.type.effort_lsb_nm)
    return foresee(expected.right(FEW), expected.loads_with_wrong_sign(mirror(spec, entry), FEW, GROSS), room)


def strained(body: PosedModel, pose: Floats) -> dict[int, str]:
    """Return the heavily loaded joints of a pose with a text for each: they should be supported."""
    found = {}
    for place, (spec, load) in enumerate(zip(body.robot.joints, body.torque(pose), strict=True)):
        most = spec.ratio * spec.type.effort_limit_nm
        if not spec.transmission and abs(load) > STRAIN * most:
            found[place] = f"{spec.name} holds {abs(load):.1f} of its {most:.1f} N·m"
    return found
