"""Faults of the line and of the adapter as a whole, by name."""

from dataclasses import replace

from twind_drivers.virtual.faulty_byte_stream import MOST, PAYLOAD, FaultyByteStream


class LineFaults:
    """Faults that touch every byte, a method for each order of the fault socket.

    They last until taken back, or healed by `clear`.
    """

    def __init__(self, stream: FaultyByteStream) -> None:
        self.stream = stream

    def bit_errors(self, rate: float, to_servos: bool = True, to_host: bool = True) -> None:
        """Flip each bit with this chance, in one direction or both. Raises ValueError outside 0..0.5."""
        if not 0.0 <= rate <= 0.5:
            raise ValueError(f"bit_errors: rate {rate} is outside 0..0.5")
        self.stream.to_servos = rate if to_servos else 0.0
        self.stream.to_host = rate if to_host else 0.0
        self.stream.look()

    def mangle(self, count: int, bits: int = 1, bytes: int = MOST) -> None:
        """Flip `bits` bits in each of the host's next `count` writes, within the first `bytes` bytes.

        Raises ValueError.
        """
        if count < 0 or not 1 <= bits <= 64 or not 1 <= bytes <= MOST:
            raise ValueError(f"mangle: {count} writes, {bits} bits, {bytes} bytes: 0 on, 1..64, 1..{MOST}")
        self.stream.mangled = count
        self.stream.mangling = (bits, bytes)
        self.stream.look()

    def babble(self, on: bool = True) -> None:
        """Send random bytes without end from a device, at the line's rate: no other packet gets through."""
        self.stream.babble(on)

    def split(self, bytes: int) -> None:
        """Deliver arriving bytes in pieces of 1 to `bytes` bytes, 5 us apart; 0: as they come.

        It takes the place of `latency`. Raises ValueError outside 0..4096.
        """
        if not 0 <= bytes <= 4096:
            raise ValueError(f"split: {bytes} bytes are outside 0..4096")
        self.stream.adapter = replace(self.stream.adapter, latency=0.0)
        self.stream.split = bytes
        self.stream.look()

    def latency(self, seconds: float, payload: int = PAYLOAD) -> None:
        """Deliver arrived bytes when `payload` bytes are full, or at the adapter's timer; 0: at once.

        FTDI: 16 ms or 1 ms; 62 bytes at full speed, 510 at high speed. Raises ValueError outside 0..0.255 s.
        """
        if not 0.0 <= seconds <= 0.255:
            raise ValueError(f"latency: {seconds} s is outside 0..0.255 s")
        if not 1 <= payload <= 4096:
            raise ValueError(f"latency: payload {payload} is outside 1..4096 bytes")
        self.stream.adapter = replace(self.stream.adapter, latency=seconds, payload=payload)
        self.stream.split = 0
        self.stream.look()

    def echo(self, on: bool = True) -> None:
        """Return the host's own bytes to it, as an adapter does that does not mute its receiver."""
        self.stream.adapter = replace(self.stream.adapter, echo=on)
        self.stream.look()

    def collide(self, on: bool = True) -> None:
        """Garble both packets of overlapping senders: host over answer, late answer over the next one.

        Off by default: the host's bytes are then served after the answer, since a loaded machine delivers
        them late.
        """
        self.stream.colliding = on
        self.look()

    def garble(self, on: bool = True) -> None:
        """Let servos at another rate answer garbled requests; the host cannot decode those answers.

        Off by default: they are silent. The e-manual does not state which is right.
        """
        self.stream.garbled = on
        self.look()

    def stall(self, on: bool = True) -> None:
        """Keep the bytes that the host sends in the adapter, up to 4096; off: they go out then."""
        self.stream.stalled = on
        self.look()

    @property
    def stalled(self) -> bool:
        """True while the adapter keeps the bytes that the host sends."""
        return self.stream.stalled

    def seed(self, number: int) -> None:
        """Start the random numbers of this bus anew. Raises ValueError below 0."""
        if number < 0:
            raise ValueError(f"seed: {number}: a seed is 0 or more")
        self.stream.restart(number)

    def look(self) -> None:
        """Update the stream. Must be called after every change."""
        self.stream.look()

    def clear(self) -> None:
        """Remove all faults of line and adapter. Bytes that a stalled adapter holds go out."""
        self.stream.heal()
