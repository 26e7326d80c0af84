"""Ranges of domain randomisation, read from a YAML file with the same strict checks as every file of twind.

A file has profiles; a quantity that a profile leaves out is not randomised.
"""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from msgspec import Meta

from twind.config.config_reader import ConfigReader, ConfigStruct, Text
from twind.config.yaml_tree import parse, read_text
from twind.learn.randomise.measured_spread import Entry, MeasuredSpread
from twind.robot.arrays import Floats

Span = tuple[float, float]  # low, high
FORMAT = "twind-ranges/1"
FILE = Path(__file__).with_name("ranges.yaml")
NONE = "none"
DEFAULT = "default"
SAME = (1.0, 1.0)
ZERO = (0.0, 0.0)
MOST_DELAY = 0.2  # s: ten control steps


@dataclass(frozen=True, slots=True)
class RangeRule:
    """Entry of a quantity in the file: its key, and the bounds of both ends."""

    key: str
    least: float
    most: float


@dataclass(frozen=True, slots=True)
class NoiseRanges:
    """Largest error of each quantity of a reading, drawn uniformly in both directions."""

    position: float = 0.0
    velocity: float = 0.0
    gyro: float = 0.0
    acceleration: float = 0.0
    gravity: float = 0.0  # of a unit vector, which stays one
    height: float = 0.0
    base_velocity: float = 0.0
    soles: float = 0.0
    sole_velocities: float = 0.0


@dataclass(frozen=True, slots=True)
class PushRanges:
    """A force in the plane on the base: when, how strong, how long."""

    every: Span  # s, from the end of one (or the start of the episode) to the next
    speed: Span  # m/s, what the whole robot would gain, had it no feet
    lasting: Span  # s


@dataclass(frozen=True, slots=True)
class RandomisationRanges:
    """Ranges [low, high] of the values drawn at each reset; the defaults change nothing."""

    friction: Span = SAME
    mass: Span = SAME
    centre_of_mass: Span = ZERO
    armature: Span = SAME
    damping: Span = SAME
    frictionloss: Span = SAME
    stiffness: Span = SAME
    braking: Span = SAME
    encoder_zero: Span = ZERO
    action_delay: Span = ZERO
    imu_delay: Span = ZERO
    start_joints: Span = ZERO
    start_tilt: Span = ZERO
    start_velocity: Span = ZERO
    pushes: PushRanges | None = None
    noise: NoiseRanges = NoiseRanges()
    # quantity -> entry -> distribution that takes the place of its range
    measured: Mapping[str, Mapping[Entry, MeasuredSpread]] = field(default_factory=dict)

    def varies(self, quantity: str, neutral: Span) -> bool:
        """Check whether a quantity is drawn at all."""
        return getattr(self, quantity) != neutral or bool(self.measured.get(quantity))

    @property
    def longest_action_delay(self) -> float:
        """Longest delay that can be drawn for a joint, s."""
        found = self.measured.get("action_delay", {}).values()
        return max([self.action_delay[1], *(spread.high for spread in found)])


def _factor(key: str) -> RangeRule:
    """Build the rule of a factor: 0.1 to 10, so that no quantity vanishes or explodes."""
    return RangeRule(key, 0.1, 10.0)


RULES: Mapping[str, RangeRule] = {
    "friction": _factor("friction"),
    "mass": _factor("mass"),
    "centre_of_mass": RangeRule("centre_of_mass_m", -1.0, 1.0),
    "armature": _factor("armature"),
    "damping": _factor("damping"),
    "frictionloss": _factor("frictionloss"),
    "stiffness": _factor("stiffness"),
    "braking": _factor("braking"),
    "encoder_zero": RangeRule("encoder_zero_rad", -0.5, 0.5),
    "action_delay": RangeRule("action_delay_s", 0.0, MOST_DELAY),
    "imu_delay": RangeRule("imu_delay_s", 0.0, MOST_DELAY),
    "start_joints": RangeRule("start_joints_rad", -1.0, 1.0),
    "start_tilt": RangeRule("start_tilt_rad", -1.0, 1.0),
    "start_velocity": RangeRule("start_velocity_m_s", -5.0, 5.0),
}
PUSHES: Mapping[str, RangeRule] = {
    "every": RangeRule("every_s", 0.02, 3600.0),
    "speed": RangeRule("speed_m_s", 0.0, 10.0),
    "lasting": RangeRule("for_s", 0.02, 2.0),
}
NOISE: Mapping[str, RangeRule] = {
    "position": RangeRule("position_rad", 0.0, 0.5),
    "velocity": RangeRule("velocity_rad_s", 0.0, 10.0),
    "gyro": RangeRule("gyro_rad_s", 0.0, 10.0),
    "acceleration": RangeRule("acceleration_m_s2", 0.0, 50.0),
    "gravity": RangeRule("gravity", 0.0, 0.5),
    "height": RangeRule("height_m", 0.0, 0.5),
    "base_velocity": RangeRule("base_velocity_m_s", 0.0, 5.0),
    "soles": RangeRule("soles_m", 0.0, 0.5),
    "sole_velocities": RangeRule("sole_velocities_m_s", 0.0, 10.0),
}


class RangesKeys(ConfigStruct):
    """Keys of a file of ranges."""

    format: Text
    profiles: ConfigReader


def load_ranges(which: str | Path | None = None) -> RandomisationRanges:
    """A profile of the built-in file by its name, or the profile `default` of a file of one's own.

    None: the profile `none`. What has a slash in it, or ends in .yaml, is a path. Raises ConfigError.
    """
    path = file_of(which)
    name = DEFAULT if path != FILE else NONE if which is None else str(which)
    return parse_ranges(read_text(path), str(path), name)


def file_of(which: str | Path | None) -> Path:
    """The file that `load_ranges` reads for it."""
    own = isinstance(which, Path) or "/" in str(which) or str(which).endswith((".yaml", ".yml"))
    return Path(str(which)) if own else FILE


def parse_ranges(text: str, file: str, profile: str) -> RandomisationRanges:
    """The `profile` of a file's text; all its profiles are checked. Raises ConfigError naming `file`."""
    whole = ConfigReader(file, parse(text, file))
    whole.require_format(FORMAT)
    found = {name: _ranges(each) for name, each in whole.read(RangesKeys).profiles.sections().items()}
    if profile not in found:
        near = difflib.get_close_matches(profile, found, 1)
        hint = f"; nearest: {near[0]}" if near else ""
        raise whole.refuse("profiles", f"no profile {profile!r}: {', '.join(found) or 'none at all'}{hint}")
    return found[profile]


def _ranges(section: ConfigReader) -> RandomisationRanges:
    section.require_known([*(rule.key for rule in RULES.values()), "pushes", "noise"])
    given: dict[str, Any] = {
        name: _span(section, rule) for name, rule in RULES.items() if section.has(rule.key)
    }
    if section.has("pushes"):
        pushes = section.section("pushes")
        pushes.require_known(rule.key for rule in PUSHES.values())
        given["pushes"] = PushRanges(**{name: _span(pushes, rule) for name, rule in PUSHES.items()})
    noise = section.section("noise")
    noise.require_known(rule.key for rule in NOISE.values())
    given["noise"] = NoiseRanges(
        **{
            name: noise.value(rule.key, Annotated[float, Meta(ge=rule.least, le=rule.most)])
            for name, rule in NOISE.items()
            if noise.has(rule.key)
        }
    )
    return RandomisationRanges(**given)


def _span(section: ConfigReader, rule: RangeRule) -> Span:
    end = Annotated[float, Meta(ge=rule.least, le=rule.most)]
    low, high = section.value(rule.key, tuple[end, end])
    if low > high:
        raise section.refuse(rule.key, f"{low:g} to {high:g} is empty: the lower end comes first")
    return low, high


class EpisodeDraw(NamedTuple):
    """Drawn values of one episode; n joints, b links. x: a factor, +: an addition."""

    friction: float  # x, sliding friction of every contact
    mass: Floats  # x, (b,), mass and inertia
    centre_of_mass: Floats  # + m, (3,), of the base, in its frame
    armature: Floats  # x, (n,)
    damping: Floats  # x, (n,)
    frictionloss: Floats  # x, (n,)
    stiffness: Floats  # x, (n,), position gain
    braking: Floats  # x, (n,), velocity gain
    encoder_zero: Floats  # rad, (n,): the encoder says this much more than is
    action_delay: float | Floats  # s; (n,) where delays of joints were measured
    imu_delay: float  # s
    start_joints: Floats  # + rad, (n,)
    start_tilt: Floats  # + rad, (2,): roll, pitch
    start_velocity: Floats  # + m/s, (2,): of the base, forward and left


class DrawSampler:
    """Draws within ranges, of a robot with `joints` joints and `links` links."""

    def __init__(
        self, ranges: RandomisationRanges, joints: int, links: int, link_names: Sequence[str] = ()
    ) -> None:
        """`link_names`: bodies in the order of the links, by which measured masses find theirs."""
        single = {"friction", "action_delay", "imu_delay"}
        single -= ranges.measured.keys()
        known = {"mass": links, "centre_of_mass": 3, "start_tilt": 2, "start_velocity": 2}
        sizes = [1 if name in single else known.get(name, joints) for name in EpisodeDraw._fields]
        spans: list[Span] = [getattr(ranges, name) for name in EpisodeDraw._fields]
        ends = np.cumsum(sizes).tolist()
        self._parts: list[slice | int] = [  # a number, or a run of them
            end - 1 if name in single else slice(end - size, end)
            for name, size, end in zip(EpisodeDraw._fields, sizes, ends, strict=True)
        ]
        self._low = np.repeat([low for low, _ in spans], sizes)
        self._width = np.repeat([high - low for low, high in spans], sizes)
        begins = {name: end - size for name, size, end in zip(EpisodeDraw._fields, sizes, ends, strict=True)}
        order = {name: number for number, name in enumerate(link_names)}
        self._measured = {
            begins[quantity] + (order[entry] if isinstance(entry, str) else entry): spread
            for quantity, spreads in ranges.measured.items()
            for entry, spread in spreads.items()
            if not isinstance(entry, str) or entry in order
        }
        self._same = dict(self._shared(ranges, begins, joints))
        self._any = bool(self._width.any()) or bool(self._measured)

    def _shared(
        self, ranges: RandomisationRanges, begins: Mapping[str, int], joints: int
    ) -> Iterator[tuple[int, int]]:
        """Yield the places whose share is that of another place.

        Braking and damping were measured as one. Delays that were not measured are one for all joints.
        """
        for joint in ranges.measured.get("braking", {}):
            assert isinstance(joint, int)
            yield begins["braking"] + joint, begins["damping"] + joint
        delays = ranges.measured.get("action_delay", {})
        others = [begins["action_delay"] + joint for joint in range(joints if delays else 0)]
        others = [place for place in others if place not in self._measured]
        for place in others[1:]:
            yield place, others[0]

    def draw(self, rng: np.random.Generator) -> EpisodeDraw:
        """The next draw: as many random numbers whatever the ranges are, none where all are points.

        Measured delays of joints take one number each.
        """
        values = self._low.copy()
        if self._any:
            shares = rng.random(values.size)
            for place, source in self._same.items():
                shares[place] = shares[source]
            values += shares * self._width
            for place, spread in self._measured.items():
                values[place] = spread.at(float(shares[place]))
        values.setflags(write=False)
        return EpisodeDraw._make(values[part] for part in self._parts)
