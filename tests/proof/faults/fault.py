"""One row of the matrix, and the outcome of one injection of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.proof.faults.ground import Ground
    from tests.proof.faults.world import World


@dataclass(frozen=True)
class Fault:
    """One row. `virtual` and `real` inject it once, and say by themselves what must be seen.

    `codes`: one of them must be told; none: it must go unnoticed, and what it must not do is looked at.
    `bound`: s, threshold + refresh + 2 ticks (docs/reason-codes.md), from when the threshold is passed.
    `instead`: why there is no virtual or no real form.
    """

    number: int
    name: str
    codes: Sequence[str]
    bound: float
    reaction: str  # what is looked for on the servos, in words
    virtual: Callable[[World], None] | None = None
    real: Callable[[Ground], None] | None = None
    instead: str = ""
    also: Sequence[str] = ()  # may be told besides
    world: type[World] | None = None  # None: that of a robot with servos alone


@dataclass
class Outcome:
    """One injection: what was wrong with it, and how soon it was told."""

    number: int
    seed: int
    delay: float | None = None  # s; None: there is nothing to tell, or it was not told
    again: int = 0  # times that it was made before, disturbed by the machine
    bound: float | None = None  # s, that this one was held to; None: that of its row
    wrong: list[str] = field(default_factory=list)
