"""Bytes of a line with the framing `FF FF`: Feetech and Dynamixel Protocol 1.0, against another search."""

from random import Random
from typing import NamedTuple

from tests.proof.fuzz.fuzz_target import FuzzTarget
from tests.proof.fuzz.mangle import EDGES, mangled, pieces
from twind_drivers.dynamixel1.dynamixel1_packet import bulk_read
from twind_drivers.feetech.feetech_packet import sync_read
from twind_drivers.half_duplex import checksum_packet as p
from twind_drivers.half_duplex.checksum_reply import CAPACITY, ChecksumReply

HOSTILE = (0xFF, 0xFF, 0xFE, 0x00, 0x02, 0x55)


class FoundPacket(NamedTuple):
    """A sound packet of a stream."""

    id: int
    code: int
    data: bytes


def packets(stream: bytes, most: int) -> list[FoundPacket]:
    """All sound packets with an id up to `most`, from left to right: the slow search."""
    found = []
    at = 0
    while at + 6 <= len(stream):
        end = at + 4 + stream[at + 3]
        whole = stream[at] == stream[at + 1] == 0xFF and at + 6 <= end <= len(stream)
        if whole and stream[at + 2] <= most and sum(stream[at + 2 : end]) % 256 == 255:
            found.append(FoundPacket(stream[at + 2], stream[at + 4], stream[at + 5 : end - 1]))
            at = end
        else:
            at += 1
    return found


class Checksum(FuzzTarget):
    """The search for packets and the replies of this framing."""

    def one(self, rng: Random) -> None:
        """One input. Raises whatever is wrong."""
        if rng.random() < 0.4:
            _noise(rng)
        else:
            _reply(rng)


def _data(rng: Random, size: int) -> bytes:
    return bytes(rng.choices(HOSTILE, k=size)) if rng.random() < 0.5 else rng.randbytes(size)


def _part(rng: Random) -> bytes:
    """A piece of a hostile stream."""
    kind = rng.randrange(6)
    if kind < 3:
        data = _data(rng, rng.choice((0, 1, 6, 15, 249)))
        return mangled(rng, p.instruction(rng.randrange(255), rng.randrange(256), data))
    if kind == 3:
        return rng.randbytes(rng.randrange(30))
    if kind == 4:
        return bytes(rng.choices(HOSTILE, k=rng.randrange(40)))
    return p.HEADER + bytes((rng.choice(EDGES), rng.choice((0, 1, 2, 3, 0xFF))))


def _noise(rng: Random) -> None:
    """Both searches find the same packets, and one that was built is found as it was built."""
    stream = b"".join(_part(rng) for _ in range(rng.choice((1, 2, 4, 8))))
    for status, most in ((True, p.LAST_ID), (False, p.BROADCAST), (None, p.BROADCAST)):
        found = [FoundPacket(*each) for each in p.find_packets(stream, status=status)]
        assert found == packets(stream, most)
    id = rng.randrange(254)
    data = _data(rng, rng.randrange(250))
    assert p.find_packets(p.instruction(id, 3, data)) == [p.ChecksumPacket(id, 3, data)]
    for sent in (sync_read((id, 1), 56, 6), bulk_read((id, 1), 36, 6), p.sync_write(42, {id: data[:6]})):
        assert len(p.find_packets(sent)) == 1


def _reply(rng: Random) -> None:
    """Data of a device only from a sound packet of its id and size; nothing but that for a whole reply."""
    ids = tuple(rng.sample(range(254), rng.choice((1, 2, 6, 24))))
    size = rng.choice((0, 1, 6, 15))
    requests = [p.read(id, 56, size) for id in ids] if rng.random() < 0.3 else [sync_read(ids, 56, size)]
    reply = ChecksumReply(ids, size, requests, refusals=rng.random() < 0.5)
    blocks = {id: _data(rng, size) for id in ids}
    good = b"".join(p.instruction(id, rng.choice((0, 0x20)), blocks[id]) for id in ids)
    echo = b"".join(requests) if rng.random() < 0.2 else b""
    stream = echo + (_part(rng) if rng.random() < 0.5 else b"") + mangled(rng, good)
    if rng.random() < 0.01:
        stream *= 1 + 2 * CAPACITY // (len(stream) + 1)
    reply.start()
    done = False
    for piece in pieces(rng, stream) if len(stream) < CAPACITY else [stream]:
        while piece and not done:
            room = reply.receive_buffer()
            assert len(room) > 0, "no room, and not done"
            count = min(len(room), len(piece))
            room[:count] = piece[:count]
            done = reply.take(count)
            piece = piece[count:]
    reply.end()
    for place, id in enumerate(ids):
        data = reply.data[place].tobytes()
        if reply.heard[place]:
            assert p.instruction(id, int(reply.error[place]), data) in stream, "data that nobody sent"
            assert reply.answered[place]
        else:
            assert not any(data), "data of a device that was not heard"
    assert reply.whole is bool(reply.heard.all())
    if stream == good and not any(request in stream for request in requests):
        assert reply.whole and reply.strays == 0
        assert all(reply.data[place].tobytes() == blocks[id] for place, id in enumerate(ids))
