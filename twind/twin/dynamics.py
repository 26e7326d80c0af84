"""Torque and balance along a path (TORQUE_INFEASIBLE, UNSTABLE_POSE), and at rest (LEAD_LIMIT).

The front process judges paths; the loop asks only for robots with devices that have no watchdog.

Inverse dynamics on a model of its own: contacts, joint stops and loops are off, so that the result is the
torque of the joints alone. The base is pinned; a free-standing robot stands as `balance` computes.
"""

import copy
from collections.abc import Generator
from dataclasses import dataclass

import mujoco
import numpy as np

from twind.robot.arrays import Floats, Ints
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.twin.binding import Binding
from twind.twin.mirror import index
from twind.twin.standing_feet import Stance, StandingFeet, tipping

SHARE = 0.8  # share of a joint's torque: more is reported or refused
# samples between two yields: some 1 ms each
PINNED = 128
FREE = 8
MOVES = 1e-9  # m or rad per rad: less than that, a joint does not move a foot
HEAVIER = 1.01  # times the torque of the standing start: a smaller excess is not caused by the path


class Dynamics:
    """Torque and balance of one robot. Keeps its own model and data: one thread, one path at a time."""

    def __init__(self, binding: Binding) -> None:
        self._model = copy.copy(binding.model)
        for off in ("CONTACT", "LIMIT", "EQUALITY"):
            bit = getattr(mujoco.mjtDisableBit, f"mjDSBL_{off}")
            self._model.opt.disableflags |= int(bit)
        self._data = mujoco.MjData(self._model)
        self._bound = SHARE * binding.limits.effort
        self._limits = binding.limits
        self._strict = binding.robot.gate.on_torque == "reject"
        self._place = index(binding.qpos)
        self._speed = index(binding.dof)
        self._dof = binding.dof
        self._base = binding.robot.base
        self._balance = StandingFeet(binding, self._model, self._data) if binding.floating else None

    def judging(
        self, time: Floats, position: Floats, velocity: Floats, acceleration: Floats
    ) -> Generator[None, None, Verdict]:
        """Judge samples of a path: time (k,) in s, the others (k, n) in rad, rad/s, rad/s².

        Samples beyond the joints' limits are slowed down or refused by other rules, and judged at the limits.
        A joint whose effort limit is unknown (NaN) is not judged where torque is only reported. It refuses
        where the robot file refuses for torque. Returns the verdict; yields every 2 ms or so.
        """
        count = len(time)
        torque = np.empty_like(position, np.float64)
        margin = np.full(count, np.nan)  # m, of the centre of mass
        step = PINNED if self._balance is None else FREE
        slower = self._slower(velocity, acceleration)
        velocity = velocity / slower
        acceleration = acceleration / slower**2
        still = np.zeros(position.shape[1])
        standing = self.sample(position[0], still, still)[0] if count else still
        for i in range(0, count, step):
            for k in range(i, min(i + step, count)):
                torque[k], margin[k] = self.sample(position[k], velocity[k], acceleration[k])
            yield
        found = self._excess(time, torque, standing)
        refusals = [each.finding for each in found if self._strict and each.worse] + self._unknown()
        warnings = [each.finding for each in found if not (self._strict and each.worse)]
        if self._balance is not None and count:
            warnings += tipping(time, margin, known=self._balance.has_feet)
        return Verdict(tuple(refusals), tuple(warnings))

    def _slower(self, velocity: Floats, acceleration: Floats) -> float:
        """Return the uniform stretch after which no sample is beyond the joints' limits."""
        fast = np.abs(velocity) / self._limits.velocity
        steep = np.sqrt(np.abs(acceleration) / self._limits.acceleration)
        return float(max(1.0, np.max(fast, initial=1.0), np.max(steep, initial=1.0)))

    def at_rest(self, position: Floats) -> Floats:
        """Return the torque (n,), N·m, that holds a pose (n,), rad; NaN where the pose is not finite."""
        if not np.isfinite(position).all():
            return np.full(len(position), np.nan)
        still = np.zeros(len(position))
        return self.sample(position, still, still)[0]

    def sample(self, position: Floats, velocity: Floats, acceleration: Floats) -> tuple[Floats, float]:
        """Return the torque (n,), N·m, NaN unknown, and the margin of balance (m)."""
        data = self._data
        data.qpos[self._place] = position
        data.qvel[self._speed] = velocity
        data.qacc[self._speed] = acceleration
        stance = None if self._balance is None else self._balance.stand()
        mujoco.mj_inverse(self._model, data)
        torque = np.array(data.qfrc_inverse[self._speed])
        if stance is None:
            return torque, np.nan
        return self._carried(torque, stance), stance.margin

    def _carried(self, torque: Floats, stance: Stance) -> Floats:
        """Return the torque with the robot's weight on its feet; on two feet each leg's share is unknown.

        For a joint above both legs (a waist) the load is the same, whichever foot carries it.
        """
        if not stance.feet:
            return torque
        columns = [self._jacobian(body) for body in stance.feet]
        on_the_way = np.array([np.abs(column[:, self._dof]).max(axis=0) > MOVES for column in columns])
        root = int(self._model.body(self._base).dofadr[0]) + np.arange(6)
        push = np.linalg.solve(columns[0][:, root].T, self._data.qfrc_inverse[root])
        torque = torque - columns[0][:, self._dof].T @ push
        shared = on_the_way.any(axis=0) & ~on_the_way.all(axis=0)
        return np.where(shared, 0.0, torque)

    def _jacobian(self, body: int) -> Floats:
        """Return the Jacobian of a body's origin: (6, nv)."""
        rows = np.zeros((6, self._model.nv))
        mujoco.mj_jacBody(self._model, self._data, rows[:3], rows[3:], body)
        return rows

    def _excess(self, time: Floats, torque: Floats, standing: Floats) -> "list[_Excess]":
        """Return every joint that needs too much torque: since when, and how much at worst."""
        size = np.abs(torque)
        bound = self._bound
        known = ~np.isnan(bound)
        over = known & ~(size <= bound)  # NaN is over
        return [
            _excess(int(joint), time, size[:, joint], np.flatnonzero(over[:, joint]), bound, standing)
            for joint in np.flatnonzero(over.any(axis=0))
        ]

    def _unknown(self) -> list[Finding]:
        joints = np.flatnonzero(np.isnan(self._bound))
        if not (self._strict and len(joints)):
            return []
        reason = (
            f"the torque of {len(joints)} joints is unknown: torque constant or current limit are missing"
        )
        return [Finding(ReasonCode.TORQUE_INFEASIBLE, joint=int(joints[0]), message=reason)]


@dataclass(frozen=True, slots=True)
class _Excess:
    """A joint that needs too much torque; `worse`: more than it needs at rest at the start."""

    finding: Finding
    worse: bool


def _excess(joint: int, time: Floats, size: Floats, over: Ints, bound: Floats, standing: Floats) -> _Excess:
    worst = int(np.where(np.isnan(size), np.inf, size).argmax())
    value = float(size[worst])
    most = float(bound[joint])
    before = abs(float(standing[joint]))
    hangs = before > most
    reason = f"more than {SHARE:g} of the joint's torque (N·m), most at {time[worst]:.3g} s"
    if hangs:
        reason += f"; {before:.3g} N·m already standing still at the start"
    finding = Finding(
        ReasonCode.TORQUE_INFEASIBLE,
        joint,
        None,
        float(time[over[0]]),
        value=value,
        bound=most,
        message=reason,
    )
    return _Excess(finding, worse=not (hangs and value <= HEAVIER * before))
