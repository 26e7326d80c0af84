"""Survey of a robot's clearance in its own poses and motions, for a review before `allow` is set.

It proposes and changes nothing: a pair that is near because the robot file is wrong would be allowed for
good.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twind.robot.finding import ReasonCode
from twind.robot.trajectory import Reference, Trajectory
from twind.twin.binding import Binding
from twind.twin.collision_model import CollisionModel, candidates
from twind.twin.curve_sweep import CurveSweep, SweepResult
from twind.twin.trajectory_precheck import along_the_way

NEIGHBOURS = 2  # joints between two bodies that are often built closer than the blocking distance


@dataclass(frozen=True, slots=True)
class NearBodies:
    """Two bodies that come near each other."""

    bodies: tuple[str, str]
    clearance: float  # m, the least
    where: str  # pose wave, motion squat at 1.2 s
    block: float  # m
    own: bool  # both belong to the robot
    joints: int  # between them, along the tree of bodies

    @property
    def refused(self) -> bool:
        """True: a motion through this place is refused."""
        return self.clearance <= self.block

    @property
    def remedy(self) -> str:
        """Remedy for a refused pair."""
        if not self.own:
            return "the robot meets its surroundings: change the pose or the motion"
        if self.joints > NEIGHBOURS:
            return (
                f"{self.joints} joints apart, so they collide: change the pose, or geoms that are too large"
            )
        pair = ", ".join(self.bodies)
        return f"neighbours; if they are built so close: collision: {{allow: [[{pair}]]}}"


@dataclass(frozen=True, slots=True)
class ClearanceSurvey:
    """Result of a survey. `near` holds the pairs below the warning distance, nearest first, each once."""

    judged: int  # pairs of geoms
    possible: int  # pairs that the model lets collide
    near: tuple[NearBodies, ...]
    bodiless: bool = False  # the robot file says that there are none

    @property
    def error(self) -> str | None:
        """Reason why there is no look-ahead for this robot; None: there is one."""
        if self.judged or self.bodiless:
            return None
        why = (
            "contype and conaffinity" if not self.possible else "support, collision.allow and collision.pairs"
        )
        return f"collision: no two bodies are judged, so nothing may move: see {why}"

    @property
    def proposed(self) -> tuple[tuple[str, str], ...]:
        """Entries of `allow` for neighbours that are refused; what is only near needs none."""
        return tuple(
            near.bodies for near in self.near if near.refused and near.own and near.joints <= NEIGHBOURS
        )

    def lines(self) -> list[str]:
        """Return the result as lines for people."""
        if self.bodiless:
            return ["clearance: collision: {bodies: none}: neither collision nor torque is judged"]
        texts = [f"clearance: {self.judged} pairs of geoms are judged, of {self.possible} that can collide"]
        for near in self.near:
            word = "too close" if near.refused else "near"
            pair = " and ".join(near.bodies)
            remedy = f" ({near.remedy})" if near.refused else ""
            texts.append(f"{word}: {pair}: {near.clearance * 1e3:.1f} mm in {near.where}{remedy}")
        return texts


def survey(binding: Binding, motions: Mapping[str, Trajectory]) -> ClearanceSurvey:
    """Survey every pose of the robot file, and `motions` by name, from the rest pose. Raises InvalidInput."""
    bodies = CollisionModel(binding)
    found: dict[tuple[str, str], NearBodies] = {}
    for name, pose in binding.robot.poses.items():
        rest = [pose[joint] for joint in binding.joint_map.names]
        _keep(found, bodies, CurveSweep(bodies).standing(rest), f"pose {name}", moving=False)
    for name, path in motions.items():
        reference = Reference(binding.rest, 0.0 * binding.rest, 0.0 * binding.rest)
        curve = along_the_way(path, reference, binding.limits, 1.0 / binding.robot.rate_hz)
        steps = CurveSweep(bodies).running(curve)
        while True:
            try:
                next(steps)
            except StopIteration as stop:
                _keep(found, bodies, stop.value, f"motion {name}", moving=True)
                break
    near = sorted(found.values(), key=lambda each: each.clearance)
    return ClearanceSurvey(
        len(bodies.pairs), len(candidates(binding.model)), tuple(near), binding.robot.gate.collision.bodiless
    )


def _keep(
    found: dict[tuple[str, str], NearBodies],
    bodies: CollisionModel,
    sweep: SweepResult,
    where: str,
    *,
    moving: bool,
) -> None:
    """Keep the nearest approach of each pair of bodies."""
    for close in (*sweep.refused, *sweep.warned):
        pair = bodies.pairs[close.pair]
        place = f"{where} at {close.at:.2f} s" if moving else where
        own = pair.code is ReasonCode.SELF_COLLISION
        before = found.get(pair.bodies)
        if before is None or close.clearance < before.clearance:
            apart = _joints_between(bodies.model, pair.geoms)
            found[pair.bodies] = NearBodies(pair.bodies, close.clearance, place, pair.block, own, apart)


def _joints_between(model: Any, geoms: tuple[int, int]) -> int:
    """Count the steps from the body of one geom to that of the other along the tree."""
    ways = []
    for geom in geoms:
        body = int(model.geom_bodyid[geom])
        way = [body]
        while body:
            body = int(model.body_parentid[body])
            way.append(body)
        ways.append(way)
    one, other = ways
    return min(one.index(body) + other.index(body) for body in one if body in other)
