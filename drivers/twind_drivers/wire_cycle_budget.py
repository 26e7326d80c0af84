"""Time of a bus's cycle against a rate, with the arithmetic for people."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class WireCycleBudget:
    """Budget of one bus's cycle. `lines`: the arithmetic, for display."""

    seconds: float
    reachable_hz: float
    lines: tuple[str, ...]

    def refusal(self, rate_hz: float) -> str | None:
        """Return the reason why `rate_hz` is impossible, with the arithmetic; None: it is possible."""
        if self.reachable_hz >= rate_hz:
            return None
        return (
            f"{rate_hz:g} Hz leaves {1e6 / rate_hz:.0f} us a cycle, "
            f"the bus needs {self.seconds * 1e6:.0f} us (up to {self.reachable_hz:.0f} Hz): "
            + "; ".join(self.lines)
        )
