"""Numbers of sign and magnitude, as servos with the framing `FF FF` have them. Pure."""


def to_word(value: int, sign: int | None, size: int) -> int:
    """Encode a number of `size` bytes: sign and magnitude with bit `sign`; None: without sign.

    Raises OverflowError.
    """
    bit = 0 if sign is None else 1 << sign
    most = (bit or 1 << 8 * size) - 1
    least = -most if bit else 0
    if not least <= value <= most:
        raise OverflowError(f"{value} does not fit a word with sign bit {sign}")
    return value if value >= 0 else -value | bit


def from_word(word: int, sign: int | None) -> int:
    """Decode sign and magnitude; minus zero is 0."""
    if sign is None or not word >> sign & 1:
        return word
    return -(word & (1 << sign) - 1)
