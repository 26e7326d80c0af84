"""`collision:` of the robot file: the least distances and the judged pairs of bodies.

Knows the file alone: whether the model has these names is found out where it is bound
(`twin/collision_model.py`).
"""

from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta

from twind.config.config_reader import ConfigReader, ConfigStruct, Text

AsPairs = Meta(description="write pairs of names, as [[l_hand, torso], [r_hand, torso]]")
Pairs = Annotated[tuple[Annotated[tuple[Text, Text], AsPairs], ...], AsPairs]
Distance = Annotated[float, Meta(ge=0.0, le=0.5)]  # m: more than that between two bodies is no clearance


@dataclass(frozen=True, slots=True)
class Clearance:
    """Distances in m between surfaces. Names are geoms or bodies of the model."""

    block: float = 0.002  # closer is refused
    warn: float = 0.010  # closer is told
    world: float = 0.020  # to what does not belong to the robot, closer is refused
    judge_world: bool = False  # the base stands where the model says, so the world around it is real
    allow: Pairs = ()  # pairs that may touch
    pairs: Pairs | None = None  # only these are judged; None: all but `allow`
    bodiless: bool = False  # the model has joints alone: nothing is judged, and `status` says so

    @property
    def band(self) -> float:
        """m: how far beyond the refusing distance it is told, for the world too."""
        return self.warn - self.block


class CollisionKeys(ConfigStruct):
    """Section `collision`: distances in m; pairs of names."""

    block_m: Distance = 0.002
    """smallest clearance between two bodies; less is refused"""
    warn_m: Distance | None = None
    """> `block_m`, ≤0.5 | 0.01 | below: warned and slowed; at least `block_m` + 8 mm by default"""
    world_m: Distance = 0.02
    """as `block_m`, between robot and surroundings; for an arm that picks up from a desk 0 to 0.005"""
    world: bool | None = None
    """| `true` with `support: fixed` | judge floor and walls. On a gantry only with the true base pose; never
    with `free`"""
    allow: Pairs = ()
    """pairs of names | | bodies or geoms that may touch: `[[l_hand, l_thigh]]`"""
    pairs: Pairs | None = None
    """pairs of names | all | judge only these"""
    bodies: Literal["", "none"] = ""
    """`none` | those of the model | the model has joints alone: neither collision nor torque is judged"""


def clearance(section: ConfigReader, support: str) -> Clearance:
    """The section, checked. `support` is the robot file's: a free base has no known place in the world.

    Raises ConfigError.
    """
    given = section.read(CollisionKeys)
    usual = max(Clearance().warn, given.block_m + 0.008)
    found = Clearance(
        block=given.block_m,
        warn=usual if given.warn_m is None else given.warn_m,
        world=given.world_m,
        judge_world=support == "fixed" if given.world is None else given.world,
        allow=given.allow,
        pairs=given.pairs,
        bodiless=given.bodies == "none",
    )
    if not found.block < found.warn:
        raise section.refuse("warn_m", f"{found.warn:g} is not above block_m, {found.block:g}")
    if found.judge_world and support == "free":
        raise section.refuse("world", "support: free has no known place in the world: only false")
    if found.pairs is not None and not found.pairs:
        raise section.refuse("pairs", "an empty list judges nothing: leave it out to judge all pairs")
    _require_distinct(section, "allow", found.allow)
    _require_distinct(section, "pairs", found.pairs or ())
    return found


def _require_distinct(section: ConfigReader, key: str, pairs: Pairs) -> None:
    """Raises ConfigError unless each pair is of two names and stands there once, in either order."""
    known: set[frozenset[str]] = set()
    for a, b in pairs:
        if a == b:
            raise section.refuse(key, f"[{a}, {b}]: one body has no distance from itself")
        if frozenset((a, b)) in known:
            raise section.refuse(key, f"[{a}, {b}] stands there twice")
        known.add(frozenset((a, b)))
