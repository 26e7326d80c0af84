"""`collision:` of the robot file: the least distances and the judged pairs of bodies.

Knows the file alone: whether the model has these names is found out where it is bound
(`twin/collision_model.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from twind.config.config_section import ConfigSection, Plain

Pairs = tuple[tuple[str, str], ...]

MOST = 0.5  # m: more than that between two bodies is no clearance


@dataclass(frozen=True, slots=True)
class Clearance:
    """Distances in m between surfaces. Names are geoms or bodies of the model."""

    block: float = 0.002  # closer is refused
    warn: float = 0.010  # closer is told
    world: float = 0.020  # to what does not belong to the robot, closer is refused
    judge_world: bool = False  # the base stands where the model says, so the world around it is real
    allow: Pairs = ()  # pairs that may touch
    pairs: Pairs | None = None  # only these are judged; None: all but `allow`

    @property
    def band(self) -> float:
        """m: how far beyond the refusing distance it is told, for the world too."""
        return self.warn - self.block


def clearance(section: ConfigSection, support: str) -> Clearance:
    """The section, checked. `support` is the robot file's: a free base has no known place in the world.

    Raises ConfigError.
    """
    usual = Clearance()
    block = section.number("block_m", usual.block, least=0.0, most=MOST)
    warn = section.number("warn_m", max(usual.warn, block + 0.008), least=0.0, most=MOST)
    if not block < warn:
        raise section.refuse("warn_m", f"{warn:g} is not above block_m, {block:g}")
    world = section.flag("world", support == "fixed")
    if world and support == "free":
        raise section.refuse("world", "support: free has no known place in the world: only false")
    found = Clearance(
        block=block,
        warn=warn,
        world=section.number("world_m", usual.world, least=0.0, most=MOST),
        judge_world=world,
        allow=_pairs(section, "allow"),
        pairs=_pairs(section, "pairs") if section.has("pairs") else None,
    )
    if found.pairs is not None and not found.pairs:
        raise section.refuse("pairs", "an empty list judges nothing: leave it out to judge all pairs")
    section.close()
    return found


def _pairs(section: ConfigSection, key: str) -> Pairs:
    """A list of pairs of names, each once, in either order."""
    given = section.plain(key)
    if not isinstance(given, list):
        if not section.has(key):
            return ()
        raise section.refuse(key, "a list of pairs is expected, as [[l_hand, torso], [r_hand, torso]]")
    found = [_pair(section, key, entry) for entry in given]
    known: set[frozenset[str]] = set()
    for pair in found:
        if frozenset(pair) in known:
            raise section.refuse(key, f"[{pair[0]}, {pair[1]}] stands there twice")
        known.add(frozenset(pair))
    return tuple(found)


def _pair(section: ConfigSection, key: str, entry: Plain) -> tuple[str, str]:
    names: Sequence[Plain] = entry if isinstance(entry, list) else ()
    if len(names) != 2:
        raise section.refuse(key, f"{entry!r} is no pair of names, as [l_hand, torso]")
    a, b = names
    if not (isinstance(a, str) and isinstance(b, str) and a and b):
        raise section.refuse(key, f"{entry!r}: both are names of geoms or bodies")
    if a == b:
        raise section.refuse(key, f"[{a}, {b}]: one body has no distance from itself")
    return a, b
