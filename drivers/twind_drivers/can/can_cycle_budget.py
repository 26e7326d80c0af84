"""Cost of a cycle on a CAN wire: bits, seconds, reachable rate, refusal with the arithmetic. Pure.

Frames are those of CAN 2.0 (ISO 11898-1): 47 bits and the payload with an id of 11 bits, 67 with one of 29,
the pause of three bits between frames included. Each is counted with the most stuff bits that it can have.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from twind_drivers.wire_cycle_budget import WireCycleBudget

# bits around the payload
STANDARD = 47
EXTENDED = 67
STUFFED = {STANDARD: 34, EXTENDED: 54}  # of these bits those that are stuffed, before the payload's own
WITH_29_BITS = ("robstride",)  # families whose ids are extended
# Frames of 8 bytes that one actuator sends a second by itself: estimates each 10 ms, a heartbeat each 100.
BY_ITSELF: Mapping[str, float] = {"odrive": 110.0}
# s, and of a period: the bus time that one transaction beside the cycle may take; more would delay the tick
SLICE = 0.002
SHARE = 0.2
HIGHEST = 1e5  # Hz, where the search for a rate ends


def frame_bits(size: int = 8, *, extended: bool = False, stuffed: bool = True) -> int:
    """Bits of one data frame of `size` bytes on the wire; `stuffed`: in the worst case, else without any."""
    around = EXTENDED if extended else STANDARD
    plain = around + 8 * size
    return plain + (STUFFED[around] + 8 * size - 1) // 4 * stuffed


@dataclass(frozen=True, slots=True)
class CanCycleBudget(WireCycleBudget):
    """One bus's cycle at one rate."""

    frames: float  # of a whole cycle
    bits: float


def registers_at_once(bitrate: int, rate_hz: float) -> int:
    """Return the registers per turn of upkeep: those that fit with their replies, at least one."""
    return max(1, int(min(SLICE, SHARE / rate_hz) * bitrate / (2 * frame_bits(extended=True))))


def budget(counts: Mapping[str, int], bitrate: int, rate_hz: float) -> CanCycleBudget:
    """Return the budget of a cycle of the actuators by family.

    It contains commands, replies, upkeep, and frames that devices send by themselves. Raises ValueError for
    no actuators, no bitrate or no rate.
    """
    if sum(counts.values()) < 1 or bitrate < 1 or not rate_hz > 0.0:
        given = f"{dict(counts)}, {bitrate} and {rate_hz}"
        raise ValueError(f"a budget needs actuators, a bitrate and a rate, got {given}")
    lines = []
    frames = 0.0
    total = 0.0
    for family, count in counts.items():
        bits = frame_bits(extended=family in WITH_29_BITS)
        cycle = 2 * count
        unrequested = count * BY_ITSELF.get(family, 0.0) / rate_hz
        lines.append(
            f"commands to {count} {family} and their replies: {cycle} frames of at most {bits} bits "
            f"= {_us(cycle * bits, bitrate)}"
        )
        if unrequested:
            lines.append(f"unrequested: {unrequested:.3g} frames = {_us(unrequested * bits, bitrate)}")
        frames = frames + cycle + unrequested
        total = total + (cycle + unrequested) * bits
    requested = min(registers_at_once(bitrate, rate_hz), sum(counts.values()))
    upkeep = _upkeep(counts, bitrate, rate_hz)
    lines.append(f"upkeep: {requested} registers, request and reply, at most {_us(upkeep, bitrate)}")
    frames = frames + 2 * requested
    total = total + upkeep
    lines.append(f"together {total:.0f} bits at {bitrate} bit/s = {_us(total, bitrate)}")
    return CanCycleBudget(total / bitrate, _reachable(counts, bitrate), tuple(lines), frames, total)


def _upkeep(counts: Mapping[str, int], bitrate: int, rate_hz: float) -> float:
    """Return the bits kept free for upkeep: its share of the period, or one register where that is longer."""
    one = 2 * frame_bits(extended=any(family in WITH_29_BITS for family in counts))
    return max(one, min(SLICE, SHARE / rate_hz, sum(counts.values()) * one / bitrate) * bitrate)


def _reachable(counts: Mapping[str, int], bitrate: int) -> float:
    """Return the highest rate (Hz) at which a cycle fits into its period; 0 where none does."""

    def fits(rate_hz: float) -> bool:
        """Return True if a cycle fits into its period at `rate_hz`."""
        bits = _upkeep(counts, bitrate, rate_hz)
        for family, count in counts.items():
            unrequested = BY_ITSELF.get(family, 0.0) / rate_hz
            bits += count * (2 + unrequested) * frame_bits(extended=family in WITH_29_BITS)
        return bits * rate_hz <= bitrate

    low = 0.0
    high = HIGHEST
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def _us(bits: float, bitrate: int) -> str:
    return f"{bits / bitrate * 1e6:.0f} us"
