"""What a cycle costs on a CAN wire: bits, seconds, reachable rate, refusal with the arithmetic. Pure.

Frames are those of CAN 2.0 (ISO 11898-1): 47 bits and the payload with an id of 11 bits, 67 with one of 29,
the pause of three bits between frames included. Each is counted with all the stuff bits that it can have.
"""

from collections.abc import Mapping
from dataclasses import dataclass

STANDARD, EXTENDED = 47, 67  # bits around the payload
STUFFED = {STANDARD: 34, EXTENDED: 54}  # of these bits those that are stuffed, before the payload's own
WITH_29_BITS = ("robstride",)  # families whose ids are extended
# Frames of 8 bytes that one actuator sends a second whoever asks: estimates each 10 ms, a heartbeat each 100.
BY_ITSELF: Mapping[str, float] = {"odrive": 110.0}
UPKEEP = 2  # frames of a turn of upkeep: one register of one actuator, asked and answered


def frame_bits(size: int = 8, *, extended: bool = False, stuffed: bool = True) -> int:
    """Bits of one data frame of `size` bytes on the wire; `stuffed`: in the worst case, else without any."""
    around = EXTENDED if extended else STANDARD
    plain = around + 8 * size
    return plain + (STUFFED[around] + 8 * size - 1) // 4 * stuffed


@dataclass(frozen=True, slots=True)
class Budget:
    """One bus's cycle at one rate. `lines` is the arithmetic, for people."""

    frames: float  # of a whole cycle
    bits: float
    seconds: float
    reachable_hz: float
    lines: tuple[str, ...]

    def refusal(self, rate_hz: float) -> str | None:
        """Why `rate_hz` is impossible, with the arithmetic; None: it is possible."""
        if self.reachable_hz >= rate_hz:
            return None
        return (
            f"{rate_hz:g} Hz leaves {1e6 / rate_hz:.0f} us a cycle, "
            f"the bus needs {self.seconds * 1e6:.0f} us (up to {self.reachable_hz:.0f} Hz): "
            + "; ".join(self.lines)
        )


def budget(counts: Mapping[str, int], bitrate: int, rate_hz: float) -> Budget:
    """The cycle of so many actuators of each family: commands, replies, upkeep, and what is sent unasked.

    Raises ValueError for no actuators, no bitrate or no rate.
    """
    if sum(counts.values()) < 1 or bitrate < 1 or not rate_hz > 0.0:
        raise ValueError(
            f"a budget needs actuators, a bitrate and a rate, got {counts}, {bitrate}, {rate_hz}"
        )
    lines, frames, each, fixed = [], 0.0, 0.0, 0.0  # `each`: bits a cycle; `fixed`: bits a second
    for family, count in counts.items():
        bits = frame_bits(extended=family in WITH_29_BITS)
        cycle, unasked = 2 * count, count * BY_ITSELF.get(family, 0.0)
        lines.append(
            f"commands to {count} {family} and their replies: {cycle} frames of at most {bits} bits "
            f"= {_us(cycle * bits, bitrate)}"
        )
        if unasked:
            lines.append(
                f"sent unasked: {unasked / rate_hz:.3g} frames = {_us(unasked / rate_hz * bits, bitrate)}"
            )
        frames, each, fixed = frames + cycle + unasked / rate_hz, each + cycle * bits, fixed + unasked * bits
    widest = frame_bits(extended=any(family in WITH_29_BITS for family in counts))
    lines.append(f"one turn of upkeep: {UPKEEP} frames = {_us(UPKEEP * widest, bitrate)}")
    frames, each = frames + UPKEEP, each + UPKEEP * widest
    total = each + fixed / rate_hz
    lines.append(f"together {total:.0f} bits at {bitrate} bit/s = {_us(total, bitrate)}")
    return Budget(frames, total, total / bitrate, max(0.0, bitrate - fixed) / each, tuple(lines))


def _us(bits: float, bitrate: int) -> str:
    return f"{bits / bitrate * 1e6:.0f} us"
