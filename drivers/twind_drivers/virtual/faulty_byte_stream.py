"""Byte stream between wire and host with faults: noise, bit errors, adapter behaviour.

Without faults the bus uses its wire directly; bytes pass here only while `bent`.
"""

from dataclasses import dataclass
from math import ceil, inf

import numpy as np

from twind_drivers.virtual.half_duplex_wire import BITS, HalfDuplexWire

GRAIN = 0.001  # s of noise handed over at once
GAP = 0.000005  # s between two pieces of what came as one
MOST = 4096  # bytes: of noise at once, and what an adapter holds that it does not send
PAYLOAD = 62  # bytes of a full-speed USB packet of an FTDI chip, behind its two status bytes


@dataclass(frozen=True, slots=True)
class SerialAdapter:
    """Properties of the adapter, which `clear` does not reset."""

    echo: bool = False  # the host receives what it sends
    latency: float = 0.0  # s, latency timer; 0: bytes are handed over at once
    payload: int = PAYLOAD  # bytes after which it does not wait for the timer: 62 full speed, 510 high speed


class FaultyByteStream:
    """Faulty byte stream: `send` to the servos, `take` to the host. Random, but the same for one seed."""

    def __init__(self, wire: HalfDuplexWire, adapter: SerialAdapter, seed: int) -> None:
        self._wire = wire
        self._adapter = adapter
        self.restart(seed)
        self._tick = inf  # s, when the latency timer hands over what is kept
        self._flushed = 0.0  # s, when it did so last
        self._piece_at = -inf  # s, when the next piece may come
        self._kept = b""  # has arrived at the adapter, not yet at the host
        self.held = b""  # taken from the host, not yet sent
        self.heal()

    def restart(self, seed: int) -> None:
        """The random numbers of this seed from their beginning."""
        self.random = np.random.default_rng(seed)

    def heal(self) -> None:
        """Back to how the adapter is made. What it holds will go its way."""
        self.adapter = self._adapter
        self.colliding = self.garbled = self.stalled = False
        self.split = 0  # bytes of the largest piece; 0: as it comes
        self.to_servos = self.to_host = 0.0  # chance that a bit flips
        # writes to come; flipped bits, in the first so many bytes
        self.mangled = 0
        self.mangling = (1, MOST)
        self.noise_left = 0.0  # s of noise that begins at the next `take`
        self._noise_at = self._noise_end = -inf  # s
        self.look()

    def look(self) -> None:
        """Return True if any fault affects the bytes. To be called after every change."""
        self.bent = bool(
            self.adapter.echo
            or self.adapter.latency
            or self.colliding
            or self.garbled
            or self.stalled
            or self.split
            or self.to_servos
            or self.to_host
            or self.mangled
            or self.noise_left
            or self._noise_at < self._noise_end
            or self._kept
            or self.held
        )

    def forget(self) -> None:
        """The adapter was pulled out: nothing it had is ever delivered."""
        self._kept = self.held = b""
        self.noise_left = 0.0
        self._noise_at = self._noise_end = self._piece_at = -inf
        self._tick = inf
        self.look()

    def babble(self, on: bool) -> None:
        """Send noise from the next `take` on, without end; False: end it."""
        self.noise_left = inf if on else 0.0
        self._noise_at = self._noise_end = -inf
        self.look()

    # ---------------------------------------------------------------------------------- the host sends

    def send(self, data: bytes, now: float) -> bytes:
        """Return the bytes that the servos receive when the host sends `data` at `now`; empty: none yet."""
        if self.stalled:
            self.held += data[: MOST - len(self.held)]
            return b""
        data = self.held + data
        self.held = b""
        if not data:
            return data
        self._begin_noise(now)
        received = self._flipped(self._mangled(data), self.to_servos)
        if self._noise_at < self._noise_end:
            received = self._drowned(received)
        met = self._wire.collide(now, received) if self.colliding else None
        if met is None and self.adapter.echo:
            start = self._wire.free_at(now)
            self._wire.interject(start + self._wire.span(len(data)), data)
        return received if met is None else met

    # ---------------------------------------------------------------------------------- bytes to the host

    def next_output_time(self) -> float:
        """Return the next time with bytes for the host, s; `inf`: none under way, `-inf`: at once."""
        if (self.held and not self.stalled) or self.noise_left:
            return -inf
        first = min(self._wire.next_output_time(), self._next_noise())
        if not self._kept:
            return first
        return min(first, self._tick if self.adapter.latency else self._piece_at)

    def take(self, now: float) -> bytes:
        """Return the bytes that have reached the host by `now`; of noise at most `MOST` bytes."""
        self._begin_noise(now)
        come = self._flipped(self._wire.take(now), self.to_host)
        if self._noise_at < self._noise_end:
            come = self._drowned(come) + self._noise(now)
        if self.adapter.latency:
            come = self._on_tick(come, now)
        elif self.split or self._kept:
            come = self._in_pieces(come, now)
        self.look()
        return come

    def _on_tick(self, come: bytes, now: float) -> bytes:
        """Full packets at once, the rest at the next tick of the timer, which every delivery starts anew."""
        latency = self.adapter.latency
        size = self.adapter.payload
        if come and not self._kept:
            ticks = max(0, ceil((now - self._flushed) / latency - 1e-9))
            self._tick = self._flushed + ticks * latency
        self._kept += come
        count = len(self._kept) if now >= self._tick else len(self._kept) // size * size
        if count:
            self._flushed = now
            self._tick = now + latency
        come = self._kept[:count]
        self._kept = self._kept[count:]
        return come

    def _in_pieces(self, come: bytes, now: float) -> bytes:
        self._kept += come
        if not self.split:
            come = self._kept
            self._kept = b""
            return come
        if not self._kept or now < self._piece_at:
            return b""
        count = int(self.random.integers(1, self.split + 1))
        self._piece_at = now + GAP
        come = self._kept[:count]
        self._kept = self._kept[count:]
        return come

    # ---------------------------------------------------------------------------------- noise

    def noise(self, seconds: float) -> bytes:
        """Random bytes that fill the line for so long."""
        return self.random.bytes(min(MOST, int(seconds * self._wire.baud / BITS)))

    def _begin_noise(self, now: float) -> None:
        if self.noise_left:
            self._noise_at = now
            self._noise_end = now + self.noise_left
            self.noise_left = 0.0

    def _next_noise(self) -> float:
        if self._noise_at < self._noise_end:
            return min(self._noise_at + GRAIN, self._noise_end)
        return inf

    def _noise(self, now: float) -> bytes:
        if now < self._next_noise():
            return b""
        since = self._noise_at
        self._noise_at = min(now, self._noise_end)
        return self.noise(self._noise_at - since)

    def _drowned(self, data: bytes) -> bytes:
        """Mix noise into `data`: with two senders the line is low as soon as one of them pulls it low."""
        noise = np.frombuffer(self.random.bytes(len(data)), np.uint8)
        return (np.frombuffer(data, np.uint8) & noise).tobytes()

    def _mangled(self, data: bytes) -> bytes:
        if not self.mangled:
            return data
        self.mangled -= 1
        bits, most = self.mangling
        broken = bytearray(data)
        size = 8 * min(len(data), most)
        for at in self.random.choice(size, min(bits, size), replace=False):
            broken[at // 8] ^= 1 << at % 8
        return bytes(broken)

    def _flipped(self, data: bytes, rate: float) -> bytes:
        if not data or not rate:
            return data
        flips = np.packbits(self.random.random(len(data) * 8) < rate)
        return (np.frombuffer(data, np.uint8) ^ flips).tobytes()
