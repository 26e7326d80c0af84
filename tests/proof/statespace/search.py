"""Breadth-first search over all histories up to a depth. States with equal keys are gone on from once.

A generator cannot be copied, so a history is run anew for each step from its end. The first broken claim is
found on a shortest history.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from tests.proof.statespace.claims import ClaimBroken
from tests.proof.statespace.state_key import state_key
from tests.proof.statespace.world import STEPS, ModelWorld


@dataclass
class SearchResult:
    """Counts of a search; `path` and `broken`: a shortest history that breaks a claim, and its text."""

    states: int = 0
    transitions: int = 0
    depth: int = 0
    closed: bool = False  # no step leads to a state that was not visited
    path: tuple[str, ...] = ()
    broken: str = ""
    by_depth: list[int] = field(default_factory=list)
    seen: set[str] = field(default_factory=set)  # states of the robot that were visited

    def __str__(self) -> str:
        if self.broken:
            return f"{self.broken}, after: {' > '.join(self.path)}"
        whole = ", complete: no further state exists" if self.closed else ""
        return f"{self.states} states, {self.transitions} transitions to depth {self.depth}{whole}"


def explore(
    depth: int,
    steps: Sequence[str] = tuple(STEPS),
    make: Callable[[], ModelWorld] = ModelWorld,
    *,
    progress: bool = False,
) -> SearchResult:
    """Visit every state that `depth` steps reach from a connected robot; stop at a broken claim."""
    result = SearchResult()
    visited = {state_key(make())}
    frontier: list[tuple[str, ...]] = [()]
    result.states = 1
    for level in range(1, depth + 1):
        reached: list[tuple[str, ...]] = []
        for path in frontier:
            if not _expand(path, steps, make, visited, reached, result):
                return result
        result.depth = level
        result.states += len(reached)
        result.by_depth.append(len(reached))
        frontier = reached
        if progress:
            print(result, flush=True)
        if not frontier:
            result.closed = True
            break
    return result


def _expand(
    path: tuple[str, ...],
    steps: Sequence[str],
    make: Callable[[], ModelWorld],
    visited: set[Any],
    reached: list[tuple[str, ...]],
    result: SearchResult,
) -> bool:
    """Take every step from the end of `path`; False: one breaks a claim."""
    world: Any = None
    here: Any = None
    for name in steps:
        if world is None:
            world = _replayed(make, path)
            here = state_key(world)
        if world.loop.condition.finished and name != "loop killed":
            continue
        result.transitions += 1
        try:
            world.step(name)
        except Exception as error:
            result.path = (*path, name)
            result.broken = str(error) if isinstance(error, ClaimBroken) else repr(error)
            return False
        key = state_key(world)
        result.seen.add(str(world.loop.condition.state))
        if key not in visited:
            visited.add(key)
            reached.append((*path, name))
        if key != here:  # else the same world serves the next step
            world = None
    return True


def _replayed(make: Callable[[], ModelWorld], path: Sequence[str]) -> ModelWorld:
    world = make()
    for name in path:
        world.step(name)
    return world
