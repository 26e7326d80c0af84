"""Comparison of the load in a sweep of one joint with the model, and with the model of other joints."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from twind.config.calibration_file import JointCalibration
from twind.robot.arrays import Bools, Floats
from twind_calibration.proving.expected_loads import ExpectedLoads, mirror
from twind_calibration.proving.proof_sweep import MeasuredLoads
from twind_calibration.proving.sign_proof import (
    NEAR,
    ContradictionKind,
    LoadVerdict,
    SignProofStatus,
    apart,
    is_explained,
    judge,
    misfits,
)
from twind_calibration.wiggling.posed_model import PosedModel


class JointMatch(Enum):
    """Result of the comparison with one other joint whose servo may be here."""

    HERE = "here"  # excluded: with that servo another load would have been measured
    THERE = "there"  # the servos are exchanged: that is what was measured
    UNTOLD = "untold"  # both would have measured the same


def by_own(measured: Floats, right: Floats, exchanged: Floats, slack: float) -> JointMatch:
    """By the joint's own load (k,); families (d, k)."""
    if not np.isfinite(measured.sum()) or apart(right, exchanged) <= 2.0 * slack:
        return JointMatch.UNTOLD
    return _place(measured, right, exchanged, slack)


def by_others(measured: Floats, right: Floats, exchanged: Floats, slack: Floats, others: Bools) -> JointMatch:
    """By how the load of the joints `others` (n,) changed; loads (k, n), slack (n,).

    Whose load does not change says nothing: it may be propped, or stick.
    """
    found = JointMatch.UNTOLD
    for joint in np.flatnonzero(others):
        one, two, three = (_changes(loads[:, joint]) for loads in (measured, right, exchanged))
        speaks = np.sqrt(np.mean(one**2)) > slack[joint]  # False for NaN
        if not speaks or apart(two[None], three[None]) <= 2.0 * slack[joint]:
            continue
        told = _place(one, two[None], three[None], float(slack[joint]))
        if told is JointMatch.THERE:
            return told
        found = told if told is JointMatch.HERE else found
    return found


def _place(measured: Floats, right: Floats, exchanged: Floats, slack: float) -> JointMatch:
    here, there = (bool((misfits(measured, each) <= slack).any()) for each in (right, exchanged))
    return JointMatch.UNTOLD if here == there else JointMatch.HERE if here else JointMatch.THERE


def _changes(loads: Floats) -> Floats:
    """Without what is the same everywhere: what sticks in a joint that stays."""
    return np.asarray(loads - loads.mean())


MOST_NAMED = 4  # joints that are named instead
BENT = 0.1  # rad: a neighbour that stands nearer to nought is no reason


@dataclass(frozen=True, slots=True)
class LoadComparisonResult:
    """Result of the comparison; joints by index. None is the joint itself."""

    judged: LoadVerdict
    like: tuple[int, ...] = ()  # contradicted: what was measured fits if servos are exchanged with these
    bent: tuple[int, ...] = ()  # contradicted: it fits if the sign of one of these is wrong
    untold: tuple[int, ...] = ()  # exchanged with these the same would have been measured


def weigh(
    body: PosedModel, joint: int, sweep: MeasuredLoads, friction: float, entry: JointCalibration | None = None
) -> LoadComparisonResult:
    """Compare the swept joint with the model: first its sign and zero, then the place of its servo.

    `entry`: its calibration, by which a wrong sign would have another zero; None: as if its travel was swept
    from end to end.
    """
    spec = body.robot.joints[joint]
    expected = ExpectedLoads(body, sweep.poses, joint)
    lsb = spec.ratio * spec.type.effort_lsb_nm
    right = expected.right()
    wrong = expected.loads_with_wrong_sign(mirror(spec, entry))
    judged = judge(sweep.up[:, joint], sweep.down[:, joint], right, wrong, friction, lsb)
    if not np.isfinite(sweep.poses).all() or body.stands_on(joint):
        return LoadComparisonResult(
            replace(judged, proof=SignProofStatus.UNOBSERVABLE, against=ContradictionKind.NOTHING)
        )
    told = _LoadMatch(
        joint, sweep, expected, right[NEAR], _rooms(body, joint, friction, judged.foreseen.slack)
    )
    places = {other: told.place(other) for other in body.twins(joint)}
    there = sorted((other for other, each in places.items() if each is JointMatch.THERE), key=told.misfit)
    if judged.proof is not SignProofStatus.CONTRADICTED:
        if told.match_with_sign_flipped() is JointMatch.THERE:
            judged = replace(judged, proof=SignProofStatus.CONTRADICTED, against=ContradictionKind.OTHERS)
        elif there:
            judged = replace(judged, proof=SignProofStatus.CONTRADICTED, against=ContradictionKind.PLACE)
        else:
            return LoadComparisonResult(
                judged, untold=tuple(o for o, place in places.items() if place is JointMatch.UNTOLD)
            )
    measured = sweep.effort[:, joint]
    room = judged.foreseen.slack
    standing = np.flatnonzero(np.abs(sweep.poses[0]) > BENT).tolist()
    bent = [
        other for other in standing if other != joint and is_explained(measured, expected.bent(other), room)
    ]
    return LoadComparisonResult(judged, _few(there), _few(bent))


def _few(places: list[int]) -> tuple[int, ...]:
    """Return the joints, or none where too many match: nearly zero load fits every joint without load."""
    return tuple(places) if len(places) <= MOST_NAMED else ()


class _LoadMatch:
    """Match of the measured loads of all joints with each possible place of the moved servo.

    `rooms` (n,) N·m.
    """

    def __init__(
        self, joint: int, sweep: MeasuredLoads, expected: ExpectedLoads, right: Floats, rooms: Floats
    ) -> None:
        self._joint = joint
        self._swept = sweep
        self._expected = expected
        self._right = right
        self._rooms = rooms
        self._all = expected.all()
        self._others = np.arange(len(rooms)) != joint

    def place(self, other: int) -> JointMatch:
        """Return whether the servo sits at joint `other`.

        Decides by its own load; where that is unclear, by the loads of the other joints.
        """
        own = by_own(
            self._swept.effort[:, self._joint],
            self._right,
            self._expected.exchanged(other),
            float(self._rooms[self._joint]),
        )
        changed = (
            JointMatch.UNTOLD
            if own is JointMatch.HERE
            else self._changed(self._expected.all_exchanged(other))
        )
        return own if changed is JointMatch.UNTOLD else changed

    def misfit(self, other: int) -> float:
        """Return the distance (N·m) of its own load from the load expected at that joint."""
        own = self._swept.effort[:, self._joint]
        return float(misfits(own, self._expected.exchanged(other)).min())

    def match_with_sign_flipped(self) -> JointMatch:
        """Return whether the others' loads changed in the opposite way: then its sign or theirs are wrong."""
        return self._changed(self._expected.all_turned())

    def _changed(self, otherwise: Floats) -> JointMatch:
        return by_others(self._swept.effort, self._all, otherwise, self._rooms, self._others)


def _rooms(body: PosedModel, joint: int, friction: float, own: float) -> Floats:
    """Return the load tolerance of each joint, (n,) N·m; all its friction for a joint that only holds."""
    rooms: Floats = friction + np.array([_unit(body, place) for place in range(len(body.robot.joints))])
    rooms[joint] = own
    return rooms


def _unit(body: PosedModel, place: int) -> float:
    """Return the torque (N·m) of the joint in one count of effort; 0 where it is unknown."""
    spec = body.robot.joints[place]
    return float(np.nan_to_num(spec.ratio * spec.type.effort_lsb_nm))
