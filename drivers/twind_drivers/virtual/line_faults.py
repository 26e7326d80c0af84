"""What is wrong with the line and the adapter as a whole, by name."""

from dataclasses import replace

from twind_drivers.virtual.faulty_byte_stream import MOST, PAYLOAD, FaultyByteStream


class LineFaults:
    """Faults that touch every byte. They last until taken back, or healed by `clear`."""

    def __init__(self, stream: FaultyByteStream) -> None:
        self.stream = stream

    def bit_errors(self, rate: float, to_servos: bool = True, to_host: bool = True) -> None:
        """Each bit flips with this chance, in one direction or both. Raises ValueError outside 0..0.5."""
        if not 0.0 <= rate <= 0.5:
            raise ValueError(f"bit_errors: rate {rate} is outside 0..0.5")
        self.stream.to_servos = rate if to_servos else 0.0
        self.stream.to_host = rate if to_host else 0.0
        self.stream.look()

    def mangle(self, count: int, bits: int = 1, bytes: int = MOST) -> None:
        """So many flipped bits in what the host writes, in its next writes, within the first `bytes` bytes.

        Raises ValueError.
        """
        if count < 0 or not 1 <= bits <= 64 or not 1 <= bytes <= MOST:
            raise ValueError(f"mangle: {count} writes, {bits} bits, {bytes} bytes: 0 on, 1..64, 1..{MOST}")
        self.stream.mangled, self.stream.mangling = count, (bits, bytes)
        self.stream.look()

    def babble(self, on: bool = True) -> None:
        """A device talks without end: random bytes at the rate of the line, and nobody is understood."""
        self.stream.babble(on)

    def split(self, bytes: int) -> None:
        """What arrives comes in pieces of 1 to `bytes` bytes, 5 us apart; 0: as it comes.

        It takes the place of `latency`. Raises ValueError outside 0..4096.
        """
        if not 0 <= bytes <= 4096:
            raise ValueError(f"split: {bytes} bytes are outside 0..4096")
        self.stream.adapter = replace(self.stream.adapter, latency=0.0)
        self.stream.split = bytes
        self.stream.look()

    def latency(self, seconds: float, payload: int = PAYLOAD) -> None:
        """The adapter hands over what has come when `payload` bytes are full, or at its timer; 0: at once.

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
        """The host hears what it sends, as on an adapter that does not mute its receiver."""
        self.stream.adapter = replace(self.stream.adapter, echo=on)
        self.stream.look()

    def collide(self, on: bool = True) -> None:
        """Who talks while another talks garbles both: the host into an answer, a late answer into the next.

        Off by default: the host's bytes are then served after the answer, since a loaded machine hands them
        over late.
        """
        self.stream.colliding = on
        self.look()

    def garble(self, on: bool = True) -> None:
        """Servos at another rate answer what they cannot understand, which the host cannot understand either.

        Off by default: they are silent. The e-manual does not say which.
        """
        self.stream.garbled = on
        self.look()

    def stall(self, on: bool = True) -> None:
        """The adapter takes what the host sends, up to 4096 bytes, and keeps it; off: it goes out then."""
        self.stream.stalled = on
        self.look()

    @property
    def stalled(self) -> bool:
        """Does the adapter keep what the host sends?"""
        return self.stream.stalled

    def seed(self, number: int) -> None:
        """Start the random numbers of this bus anew. Raises ValueError below 0."""
        if number < 0:
            raise ValueError(f"seed: {number}: a seed is 0 or more")
        self.stream.restart(number)

    def look(self) -> None:
        """To be called after every change."""
        self.stream.look()

    def clear(self) -> None:
        """The line is sound again, the adapter as it is made. What a stalled one holds goes out."""
        self.stream.heal()
