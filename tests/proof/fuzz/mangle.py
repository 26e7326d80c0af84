"""Ways to make valid bytes invalid. Everything is drawn from the `random.Random` that is passed in."""

from random import Random

EDGES = (0x00, 0x01, 0x55, 0x7F, 0x80, 0xFD, 0xFE, 0xFF)


def mangled(rng: Random, data: bytes, times: int | None = None) -> bytes:
    """`data` after some changes: bits, bytes, pieces lost, doubled, swapped or cut off."""
    piece = bytearray(data)
    for _ in range(rng.choice((0, 1, 1, 1, 2, 5)) if times is None else times):
        if not piece:
            return bytes(piece)
        at, end = sorted(rng.randrange(len(piece) + 1) for _ in range(2))
        kind = rng.randrange(7)
        if kind == 0:
            piece[min(at, len(piece) - 1)] ^= 1 << rng.randrange(8)
        elif kind == 1:
            piece[min(at, len(piece) - 1)] = rng.choice(EDGES)
        elif kind == 2:
            del piece[at : min(end, at + 8)]
        elif kind == 3:
            piece[at:at] = piece[at : min(end, at + 64)]
        elif kind == 4:
            piece[at:at] = rng.randbytes(rng.randrange(6))
        elif kind == 5:
            del piece[end:]
        else:
            piece[at:end] = piece[at:end][::-1]
    return bytes(piece)


def pieces(rng: Random, data: bytes) -> list[bytes]:
    """`data` as it might arrive: whole, byte by byte, or in some chunks."""
    size = rng.choice((1, 3, 17, 64, len(data) or 1, len(data) or 1))
    return [data[at : at + size] for at in range(0, len(data), size)]
