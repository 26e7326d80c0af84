"""The list of the wrong daemons of a CAN bus: each says which rule it breaks."""

from collections.abc import Callable
from dataclasses import dataclass

from tests.proof.evil.can_good import Good


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
    """Puts a wrong daemon on the list."""

    def put(daemon: type[Good]) -> type[Good]:
        EVILS.append(Evil(rule, daemon))
        return daemon

    return put
