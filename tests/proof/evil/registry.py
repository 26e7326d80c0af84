"""Lists of wrong daemons: each entry names the rule that its daemon breaks."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from tests.proof.evil.daemon_life import DaemonLife

Daemon = TypeVar("Daemon", bound=DaemonLife)


@dataclass(frozen=True)
class Evil(Generic[Daemon]):
    """A wrong daemon, and the only rule that it breaks."""

    rule: str
    daemon: type[Daemon]

    @property
    def name(self) -> str:
        return f"{self.rule}-{self.daemon.__name__}"


class WrongDaemons(list[Evil[Daemon]]):
    """All wrong daemons of one kind of bus."""

    def breaks(self, rule: str) -> Callable[[type[Daemon]], type[Daemon]]:
        """Decorate a daemon that breaks this rule and no other."""

        def note(daemon: type[Daemon]) -> type[Daemon]:
            self.append(Evil(rule, daemon))
            return daemon

        return note

    def derive(self, rule: str, name: str, base: type[Daemon], **attributes: object) -> type[Daemon]:
        """Add a daemon that differs from `base` in these attributes only."""
        return self.breaks(rule)(type(name, (base,), attributes))
