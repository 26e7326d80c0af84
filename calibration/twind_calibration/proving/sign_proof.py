"""Judgement of a joint's sign and zero by its load. Pure.

The load is measured at k places, each come to from below and from above: friction cancels in the mean. It is
held against families of loads: what would be measured if the joint were as described, turned round or another
one; one row (k,) for each zero error that is tried. A family also stretches, since a servo's torque
per ampere is known to 40 %.

A limb that hangs has a load odd in its angle: turned round, place and load both flip, and the very same is
measured. Where the two families come nearer to each other than friction leaves room for, the sign cannot be
told, however well the load fits. A wrong sign may have brought a wrong zero with it: that of `mirror` is
tried as well.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import radians

import numpy as np

from twind.robot.arrays import Bools, Floats
from twind_calibration.wiggling.move_evidence import UNSURE

GROSS = radians(5.0)  # a zero that is off by more contradicts; jig or stop do better, gravity hardly
FINE = 8  # rows of a family for each that the model is asked for: between them loads are straight lines
ASKED: Floats = np.linspace(-12.0 * GROSS, 12.0 * GROSS, 49)  # rad, zero errors that the model is asked for
CLOSE: Floats = ASKED[np.abs(ASKED) <= GROSS + 1e-9]
ZEROS: Floats = np.linspace(ASKED[0], ASKED[-1], FINE * (len(ASKED) - 1) + 1)  # those of the rows
NEAR: Bools = np.abs(ZEROS) <= GROSS + 1e-9
STRETCH = (1.0 - UNSURE, 1.0 + UNSURE)
LEFT = 0.5  # of friction that the mean of both directions may still hold


class SignProofStatus(StrEnum):
    """Status of the proof of a joint's sign."""

    PROVED = "proved"
    PLAUSIBLE = "plausible"  # its load fits, and with the other sign it would not, but nearly
    UNOBSERVABLE = "unobservable"  # with the other sign it would fit as well, or nothing is measured
    CONTRADICTED = "contradicted"
    CONFIRMED = "confirmed"  # nothing speaks against it, and a person saw it go the right way


class ContradictionKind(StrEnum):
    """Kind of evidence against the calibration."""

    NOTHING = ""
    MOTION = "motion"  # the encoder, or another joint that moves with it
    SIGN = "sign"  # the load fits the joint turned round
    ZERO = "zero"  # it fits with a zero that is grossly off
    CURRENT = "current"  # it fits with the torque told the other way round
    OTHERS = "others"  # its own load fits both signs, that of others changes as if its sign were wrong
    PLACE = "place"  # the load of the others fits another joint's servo
    NEITHER = "neither"
    EYE = "eye"  # who watched saw something else


@dataclass(frozen=True, slots=True)
class WrongSignLoads:
    """Expected loads with a wrong sign, N·m; a row (k,) for each zero, each within 5 degrees."""

    near: Floats  # (d, k), its zero as it is told
    mirrored: Floats  # (e, k), its zero where the same travel would have placed it with that sign

    @property
    def all(self) -> Floats:
        """(d + e, k)."""
        return np.vstack((self.near, self.mirrored))


@dataclass(frozen=True, slots=True)
class LoadPrediction:
    """Prediction by the model before the motion. N·m, rms over the places."""

    span: float  # between the largest and the smallest load
    flip: float  # between the load as described and the nearest that a wrong sign measures
    apart: float  # what is left of it whatever the zero (within 5 degrees) and the torque per ampere
    slack: float  # what a measured load may be off

    @property
    def observable(self) -> bool:
        """No measured load fits both signs."""
        return self.apart > 2.0 * self.slack

    @property
    def visible(self) -> bool:
        """The signs differ by more than friction, if zero and torque per ampere are right."""
        return self.flip > 2.0 * self.slack


@dataclass(frozen=True, slots=True)
class LoadVerdict:
    """Result for the load of one joint. N·m, rms; rad."""

    proof: SignProofStatus
    against: ContradictionKind
    foreseen: LoadPrediction
    slope_ratio: float  # measured over described; NaN: no load to compare with
    misfit: float  # to the best that a right sign allows
    misfit_reversed: float
    offset: float  # rad, of the zero; NaN: the span does not tell
    offset_unsure: float  # rad, either way
    friction: float  # half of what lies between the directions


def slack(friction: float, lsb: float) -> float:
    """Return the tolerance (N·m) of the mean of both directions, for this friction and unit of effort."""
    return LEFT * friction + (lsb if np.isfinite(lsb) else 0.0)


def refined(family: Floats) -> Floats:
    """A family (d, k) with FINE rows for one."""
    rows = np.linspace(0.0, len(family) - 1.0, FINE * (len(family) - 1) + 1)
    first = np.minimum(rows.astype(np.intp), len(family) - 2)
    share = (rows - first)[:, None]
    return np.asarray((1.0 - share) * family[first] + share * family[first + 1])


def foresee(right: Floats, wrong: WrongSignLoads, slack: float) -> LoadPrediction:
    """`right`: (d, k), the middle row without a zero error."""
    described = right[len(right) // 2]
    every = wrong.all
    return LoadPrediction(
        span=float(np.ptp(described)),
        flip=float(np.sqrt(((every - described) ** 2).mean(axis=1)).min()),
        apart=apart(right, every),
        slack=slack,
    )


def apart(one: Floats, other: Floats) -> float:
    """Least distance (rms) of two families (d, k), (e, k), each row stretched as it likes within 40 %."""
    a = (one**2).sum(axis=1)[:, None]
    b = (other**2).sum(axis=1)[None]
    ab = one @ other.T
    least = np.inf
    for s in STRETCH:  # the least of a bowl that opens at nought lies on the edge of what is allowed
        for first, second in ((a, b), (b, a)):
            t = _stretched(s * ab, second)
            least = min(least, float((s * s * first - 2.0 * s * t * ab + t * t * second).min()))
    return float(np.sqrt(max(least, 0.0) / one.shape[1]))


def misfits(measured: Floats, family: Floats) -> Floats:
    """Rms (d,) between what was measured (k,) and each row of a family, stretched to fit best."""
    stretch = _stretched(family @ measured, (family**2).sum(axis=1))
    found: Floats = np.sqrt(((stretch[:, None] * family - measured) ** 2).mean(axis=1))
    return found


def is_explained(measured: Floats, family: Floats, slack: float) -> bool:
    """One of its rows is what was measured."""
    return bool((misfits(measured, family) <= slack).any())


def _stretched(product: Floats, square: Floats) -> Floats:
    """The best stretch within what is allowed; of a row without load any is as good."""
    free = np.divide(
        product, square, out=np.ones_like(product), where=np.broadcast_to(square > 0.0, product.shape)
    )
    found: Floats = np.clip(free, *STRETCH)
    return found


def judge(
    up: Floats, down: Floats, right: Floats, wrong: WrongSignLoads, friction: float, lsb: float
) -> LoadVerdict:
    """Loads (k,) come to from below and from above; `right` (d, k) over ZEROS.

    `friction` (N·m): the least that is reckoned with; more is, where the directions lie farther apart.
    """
    measured = (up + down) / 2.0
    rubbed = float(np.abs(up - down).mean()) / 2.0
    room = slack(max(friction, rubbed) if np.isfinite(rubbed) else friction, lsb)
    foreseen = foresee(right[NEAR], wrong, room)
    if not np.isfinite(measured.sum() + right.sum() + wrong.all.sum()):
        nan = float("nan")
        return LoadVerdict(
            SignProofStatus.UNOBSERVABLE, ContradictionKind.NOTHING, foreseen, nan, nan, nan, nan, nan, nan
        )
    all_right = misfits(measured, right)
    proof, against = _verdict(measured, right, all_right, wrong, foreseen)
    offset, unsure = _offset(all_right, room)
    middle = right[len(right) // 2]
    square = float(middle @ middle)
    return LoadVerdict(
        proof=proof,
        against=against,
        foreseen=foreseen,
        slope_ratio=float(middle @ measured) / square if square > len(middle) * room**2 else float("nan"),
        misfit=float(all_right[NEAR].min()),
        misfit_reversed=float(misfits(measured, wrong.all).min()),
        offset=offset,
        offset_unsure=unsure,
        friction=rubbed,
    )


def _verdict(
    measured: Floats, right: Floats, wide: Floats, wrong: WrongSignLoads, predicted: LoadPrediction
) -> tuple[SignProofStatus, ContradictionKind]:
    """`wide`: misfits of a right sign over ZEROS. A sign is doubted after a zero that would do as well."""
    room = predicted.slack
    near = is_explained(measured, wrong.near, room)
    mirrored = is_explained(measured, wrong.mirrored, room)
    if (wide[NEAR] <= room).any():
        if near or mirrored:
            return SignProofStatus.UNOBSERVABLE, ContradictionKind.NOTHING
        if predicted.observable:
            return SignProofStatus.PROVED, ContradictionKind.NOTHING
        return (
            SignProofStatus.PLAUSIBLE if predicted.visible else SignProofStatus.UNOBSERVABLE,
            ContradictionKind.NOTHING,
        )
    if near:
        return SignProofStatus.CONTRADICTED, ContradictionKind.SIGN
    if (wide <= room).any():
        return SignProofStatus.CONTRADICTED, ContradictionKind.ZERO
    if mirrored:
        return SignProofStatus.CONTRADICTED, ContradictionKind.SIGN
    if is_explained(measured, -right[NEAR], room):
        return SignProofStatus.CONTRADICTED, ContradictionKind.CURRENT
    return SignProofStatus.CONTRADICTED, ContradictionKind.NEITHER


def _offset(misfits: Floats, room: float) -> tuple[float, float]:
    """The zero errors that fit: their middle and half width, rad; NaN: unknown."""
    fitting = ZEROS[misfits <= room]
    if not len(fitting) or fitting[0] == ZEROS[0] or fitting[-1] == ZEROS[-1]:
        return float("nan"), float("nan")
    step = float(ZEROS[1] - ZEROS[0])  # a zero error that fits may lie up to one row further out
    return float(fitting[0] + fitting[-1]) / 2.0, float(fitting[-1] - fitting[0]) / 2.0 + step
