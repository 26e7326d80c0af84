"""Draft of a robot: facts with their sources, gathered from files and scans before a robot file is written.

A fact of the first source stays; another value of a later source is a conflict, which is reported and left to
the owner. Whatever no source states is an open item of the robot file's key `todo`.
"""

import math
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

from twind.command_line.verb import Rejected, UsageError
from twind.config.bus_config import NAME
from twind.config.driver_family import families, family_of

# What a source may state of one joint. Limits in rad, or in counts of its servo, 0 where the servo counts 0.
JOINT_FACTS = (
    *("id", "bus", "device", "protocol", "sign", "ratio", "lower", "upper", "lower_count", "upper_count"),
    *("model_joint", "velocity", "mode"),
)
BUS_FACTS = ("port", "baud", "protocol")
TIGHTER: Mapping[str, Callable[[float, float], float]] = {"lower": max, "upper": min, "velocity": min}


class Fact(NamedTuple):
    """A value and the source that states it."""

    value: Any
    source: str


@dataclass
class FactSet:
    """Facts of one thing by key, and what later sources state differently."""

    name: str
    facts: dict[str, Fact] = field(default_factory=dict)
    conflicts: dict[str, list[Fact]] = field(default_factory=dict)

    def state(self, key: str, value: Any, source: str) -> None:
        """Take a fact. A different value of a known one is a conflict; of limits the tighter one stays."""
        known = self.facts.setdefault(key, Fact(value, source))
        if key in TIGHTER:
            if TIGHTER[key](known.value, value) != known.value:
                self.facts[key] = Fact(value, source)
        elif not _is_same(known.value, value):
            self.conflicts.setdefault(key, []).append(Fact(value, source))

    def get(self, key: str, default: Any = None) -> Any:
        """Return the value of a fact."""
        return self.facts[key].value if key in self.facts else default

    def source(self, key: str) -> str:
        """Return the source of a fact; empty where nobody states it."""
        return self.facts[key].source if key in self.facts else ""


@dataclass
class RobotDraft:
    """Everything known so far of one robot."""

    name: str
    joints: dict[str, FactSet] = field(default_factory=dict)
    buses: dict[str, FactSet] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def joint(self, name: str) -> FactSet:
        """Return the facts of a joint, which is new where no source named it."""
        return self.joints.setdefault(name, FactSet(name))

    def bus(self, name: str) -> FactSet:
        """Return the facts of a bus."""
        return self.buses.setdefault(name, FactSet(name))

    def joint_of(self, bus: str, number: int) -> FactSet | None:
        """Return the joint with a device id on a bus; None: no joint has that id there.

        A joint whose bus no source states has its id on any bus. Raises Rejected: two joints may be meant.
        """
        found = [each for each in self.joints.values() if each.get("id") == number]
        found = [each for each in found if each.get("bus") in (None, bus)]
        if len(found) > 1:
            names = " and ".join(each.name for each in found)
            raise Rejected(f"id {number} on {bus} is that of {names}: say --bus JOINT=BUS")
        return found[0] if found else None

    def select(self, pattern: str, option: str) -> list[str]:
        """Return the names of the joints that a shell pattern matches. Raises UsageError: none."""
        found = [name for name in self.joints if name == pattern or fnmatchcase(name, pattern)]
        if not found:
            raise UsageError(f"{option}: no source has a joint {pattern}: {', '.join(self.joints)}")
        return found

    def leave_out(self, patterns: Sequence[str]) -> None:
        """Remove the joints that shell patterns match. Raises UsageError: a pattern matches none."""
        unwanted = [self.select(pattern, f"--without {pattern}") for pattern in patterns]
        for name in {name for names in unwanted for name in names}:
            del self.joints[name]

    def rename(self, names: Mapping[str, str]) -> None:
        """Rename joints, in their places. Raises Rejected: no such joint, a wrong name, or one name twice."""
        for old in names:
            if old not in self.joints:
                raise Rejected(
                    f"--joint {old}={names[old]}: no source has a joint {old}: {', '.join(self.joints)}"
                )
        named = [(names.get(each.name, each.name), each) for each in self.joints.values()]
        self.joints = {}
        for name, facts in named:
            if not NAME.fullmatch(name):
                raise Rejected(
                    f"joint {name!r}: use 1 to 64 letters, digits, _ . and -; name it with --joint "
                    f"{shlex.quote(f'{facts.name}=NAME')}"
                )
            if name in self.joints:
                raise Rejected(f"two joints would be called {name}")
            facts.name = name
            self.joints[name] = facts

    def conflicts(self) -> Iterator[str]:
        """Yield each disagreement of two sources as text."""
        for each in (*self.joints.values(), *self.buses.values()):
            for key, others in each.conflicts.items():
                for other in others:
                    yield (
                        f"{each.name}: {key} is {each.get(key)!r} by {each.source(key)}, {other.value!r} by "
                        f"{other.source}: correct one, or leave one out"
                    )


def find_device(text: str, protocol: float | None = None) -> str:
    """Return the name of a model as a robot file spells it. Raises Rejected: none, or several.

    `protocol`: of Dynamixel servos that exist with both, 1.0 or 2.0.
    """
    wanted = _plain(text)
    known = {model: each.kind for each in families() for model in each.models()}
    found = [model for model in known if _plain(model) == wanted]
    if protocol is not None:
        found = [model for model in known if _plain(model) == _plain(f"{wanted}{protocol:.1f}")] or found
    if not found:
        near = sorted(model for model in known if wanted and _plain(model).startswith(wanted))
        if len(near) != 1:
            plain = {_plain(model): model for model in known}
            near = near or [plain[name] for name in get_close_matches(wanted, plain, 3)]
            options = f"; nearest: {', '.join(near[:8])}" if near else f"; known: {', '.join(sorted(known))}"
            raise Rejected(f"device {text!r}: no model of that name{options}")
        found = near
    return found[0]


def protocol_of(device: str) -> float:
    """Return the protocol of a model that a scan found. Models of one protocol are named without it."""
    return 1.0 if family_of(device).kind == "dynamixel1" else 2.0


def _plain(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.casefold())


def _is_same(one: Any, other: Any) -> bool:
    if isinstance(one, float) or isinstance(other, float):
        return math.isclose(float(one), float(other), rel_tol=1e-6, abs_tol=1e-6)
    return bool(one == other)
