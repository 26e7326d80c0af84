"""The list of the wrong daemons: each says which rule it breaks."""

from collections.abc import Callable
from dataclasses import dataclass

from tests.proof.evil.good import Good


@dataclass(frozen=True)
class Evil:
    """One of them."""

    rule: str
    daemon: type[Good]

    @property
    def name(self) -> str:
        return f"{self.rule}-{self.daemon.__name__}"


EVILS: list[Evil] = []


def breaks(rule: str) -> Callable[[type[Good]], type[Good]]:
    """Note a daemon that breaks this rule, and no other."""

    def note(daemon: type[Good]) -> type[Good]:
        EVILS.append(Evil(rule, daemon))
        return daemon

    return note
