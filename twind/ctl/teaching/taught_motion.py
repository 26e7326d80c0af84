"""Motion from a hand's path: points, a way to its start, and what the gate needs changed.

A hand knows neither limits nor speeds. Positions outside the limits are moved into them. Where the path is
too fast it takes longer, there alone. Both are stated.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import numpy as np

from twind.motion.hand_path import Deviation, HandPath, deviation, excess, simplify
from twind.robot.arrays import Floats
from twind.robot.finding import Finding, ReasonCode
from twind.robot.splines import Knots
from twind.safety.retime import HEALED, needed

ROUNDS = 30  # judgements until a path passes; each moves it further into the limits, or slows it down more
MOVES = 3.5  # bounds of the simplification: so far inside its limit a joint is moved at most
MARGIN = 1.01  # on what a place needs: the gate finds the peaks between two samples
DIGITS = 6  # of rad, rad/s and s in the file

VerdictMessage = Mapping[str, Any]  # `Verdict` of the interface
FindingMessages = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class RefusalBounds:
    """Bounds that refusals have stated so far, else infinite. Arrays (m,): rad, rad/s, rad/s²."""

    lower: Floats
    upper: Floats
    velocity: Floats
    acceleration: Floats


@dataclass(frozen=True, slots=True)
class TaughtMotion:
    """Points of `joints` for a `hand`'s path; the first is reached `lead` s after the start."""

    joints: tuple[str, ...]
    hand: HandPath
    bound: float  # rad, of the simplification
    lead: float  # s
    path: HandPath  # of the hand, slowed down
    bounds: RefusalBounds
    reasons: Mapping[tuple[str, str], str] = field(default_factory=dict)  # by code and joint, the first place
    points: Knots = field(init=False)

    def __post_init__(self) -> None:
        lower = self.bounds.lower
        upper = self.bounds.upper
        points = simplify(self.path.clipped(lower, upper), self.bound)
        kept = replace(points, position=np.clip(points.position, lower, upper))
        object.__setattr__(self, "points", kept)

    @property
    def slowest(self) -> float:
        """Duration of the slowest step over that of the hand."""
        return float((np.diff(self.path.time) / np.diff(self.hand.time)).max())

    @property
    def added(self) -> float:
        """Time by which it is longer than the hand's path, s."""
        return float(np.ptp(self.path.time) - np.ptp(self.hand.time))

    def deviation(self) -> Deviation:
        """Return the largest distance from the hand's path at equal phase, and the time of the hand there."""
        worst = deviation(self.points, self.path)
        sample = np.searchsorted(self.path.time - self.path.time[0], worst.time)
        return worst._replace(time=float(self.hand.time[sample] - self.hand.time[0]))

    @property
    def still(self) -> bool:
        """True where no joint left its first position by more than `bound`."""
        return bool((np.abs(self.hand.position - self.hand.position[0]) <= self.bound).all())

    def clipped(self) -> dict[str, float]:
        """Return by how much (rad) joints were moved into their limits; others are left out."""
        inside = self.hand.clipped(self.bounds.lower, self.bounds.upper)
        far = np.abs(self.hand.position - inside.position).max(axis=0)
        return {name: float(by) for name, by in zip(self.joints, far, strict=True) if by > 0.0}

    def trajectory(self) -> dict[str, Any]:
        """Return it as a `Trajectory` of the interface."""
        points = self.points
        assert points.velocity is not None  # `simplify` gives them
        time = points.time - points.time[0] + self.lead
        rows = zip(_rounded(points.position), _rounded(points.velocity), _rounded(time), strict=True)
        keys = ("positions", "velocities", "time_from_start")
        return {
            "joint_names": list(self.joints),
            "points": [dict(zip(keys, row, strict=True)) for row in rows],
        }

    def corrected(self, refusals: FindingMessages) -> "TaughtMotion | None":
        """Return the motion in the limits, or at the speed, that the refusals need; None: neither helps."""
        outside = [each for each in refusals if each["code"] == ReasonCode.POS_LIMIT]
        fast = [each for each in refusals if each["code"] in HEALED]
        if outside:
            bounds = self._narrower(outside)
            return None if bounds is None else replace(self, bounds=bounds)
        return self._slower(fast) if fast else None

    def _narrower(self, outside: FindingMessages) -> RefusalBounds | None:
        """Return bounds within these limits, less what a cubic may go beyond the samples that it passes.

        None: that was done already, and a joint is outside for another reason.
        """
        lower = self.bounds.lower.copy()
        upper = self.bounds.upper.copy()
        for each in outside:
            joint = self.joints.index(each["joint"])
            if each["value"] > each["bound"]:
                upper[joint] = min(upper[joint], each["bound"]) - self.bound
            else:
                lower[joint] = max(lower[joint], each["bound"]) + self.bound
            if not lower[joint] - MOVES * self.bound <= each["bound"] <= upper[joint] + MOVES * self.bound:
                return None
        return replace(self.bounds, lower=lower, upper=upper)

    def _slower(self, fast: FindingMessages) -> "TaughtMotion | None":
        """Return the path slowed down wherever it exceeds a speed or an acceleration that was refused."""
        velocity = self.bounds.velocity.copy()
        acceleration = self.bounds.acceleration.copy()
        rows = {ReasonCode.VEL_LIMIT: velocity, ReasonCode.ACC_LIMIT: acceleration}
        for each in fast:
            if (limit := rows.get(each["code"])) is not None:
                limit[self.joints.index(each["joint"])] = each["bound"]
        pace = excess(self.points, self.path, velocity, acceleration)
        reasons = dict(self.reasons)
        for each in fast:
            place = self._sample(each["time"])
            pace[place] = max(pace[place], _needed(each))
            at = f"at {self.hand.time[place] - self.hand.time[0]:.2f} s"
            unit = "rad/s²" if each["code"] == ReasonCode.ACC_LIMIT else "rad/s"
            text = f"{each['joint']} {at}: {each['value']:.3g}, bound {each['bound']:.3g} {unit}"
            reasons.setdefault((each["code"], each["joint"]), text)
        if not 1.0 < pace.max() < inf:
            return None
        slower = self.path.slowed(np.where(pace > 1.0, MARGIN * pace, 1.0))
        bounds = replace(self.bounds, velocity=velocity, acceleration=acceleration)
        return replace(self, path=slower, bounds=bounds, reasons=reasons)

    def _sample(self, time: float) -> int:
        """Return the sample next to a time (s) of `trajectory`."""
        elapsed = self.path.time - self.path.time[0]
        return int(np.abs(elapsed - (time - self.lead + self.points.time[0])).argmin())


def taught_motion(joints: tuple[str, ...], hand: HandPath, bound: float, lead: float) -> TaughtMotion:
    """Return the motion of a hand's path before the gate has judged it."""
    none = np.full(len(joints), inf)
    return TaughtMotion(joints, hand, bound, lead, hand, RefusalBounds(-none, none, none, none))


def passed_by_gate(
    motion: TaughtMotion, check: Callable[[dict[str, Any]], VerdictMessage]
) -> tuple[TaughtMotion, VerdictMessage]:
    """Return the motion as `check` (the call `Check`) passes it, and its verdict.

    What neither limits nor speed correct, such as a collision, is still refused.
    """

    def judge(motion: TaughtMotion) -> VerdictMessage:
        # Else the gate slows the whole motion down where the robot file permits it, and does not refuse.
        return check({**motion.trajectory(), "policy": "reject"})

    verdict = judge(motion)
    for _ in range(ROUNDS):
        better = motion.corrected(verdict["refusals"])
        if better is None:
            break
        motion = better
        verdict = judge(motion)
    return motion, verdict


def _needed(sent: Mapping[str, Any]) -> float:
    return needed([Finding(ReasonCode(sent["code"]), value=sent["value"], bound=sent["bound"])])


def _rounded(rows: Floats) -> list[Any]:
    plain: list[Any] = (np.round(rows, DIGITS) + 0.0).tolist()  # + 0.0: no -0.0
    return plain
