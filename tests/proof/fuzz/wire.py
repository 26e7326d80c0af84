"""Bytes of a bus: whatever comes, the parsers find what is whole and sound, and hold little (P1, P2, P3)."""

from random import Random

from tests.proof.fuzz.fuzz_target import FuzzTarget
from tests.proof.fuzz.mangle import EDGES, mangled, pieces
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.packet import Framer
from twind_drivers.dynamixel.replies import FastSyncReadReply, StatusReply

HOSTILE = (0xFF, 0xFF, 0xFD, 0x00, 0x55)
KINDS = ("noise", "noise", "noise", "round trip", "reply")


class Wire(FuzzTarget):
    """The framer and the replies of Protocol 2.0."""

    def one(self, rng: Random) -> None:
        """One input. Raises whatever is wrong."""
        kind = rng.choice(KINDS)
        if kind == "round trip":
            _round_trip(rng)
        elif kind == "reply":
            _reply(rng)
        else:
            _noise(rng)


def _params(rng: Random) -> bytes:
    size = rng.choice((0, 1, 4, 10, 10, 40))
    return bytes(rng.choices(HOSTILE, k=size)) if rng.random() < 0.5 else rng.randbytes(size)


def _packet(rng: Random) -> bytes:
    id = rng.choice((0, 1, 7, 252, rng.randrange(253)))
    if rng.random() < 0.6:
        return p.status(id, rng.choice((0, 0, 0x80, rng.randrange(256))), _params(rng))
    return p.instruction(rng.choice((id, p.BROADCAST)), rng.choice(list(p.Instruction)), _params(rng))


def _part(rng: Random) -> bytes:
    """A piece of a hostile stream."""
    kind = rng.randrange(7)
    if kind < 3:
        return mangled(rng, _packet(rng))
    if kind == 3:
        return rng.randbytes(rng.randrange(30))
    if kind == 4:
        return bytes(rng.choices(HOSTILE, k=rng.randrange(40)))
    if kind == 5:  # a header that promises much
        length = rng.choice((0, 2, 3, 4, 300, p.CAPACITY - 8, p.CAPACITY - 7, p.CAPACITY - 6, 0x7FFF, 0xFFFF))
        return p.HEADER + bytes((rng.choice(EDGES),)) + length.to_bytes(2, "little") + b"\x55"
    return p.PATTERN * rng.randrange(1, 8)


def _noise(rng: Random) -> None:
    """P1 and P2: nothing is raised, 2 KiB are never exceeded, each byte is accounted for, and what is sound
    is found behind it."""
    stream = b"".join(_part(rng) for _ in range(rng.choice((1, 2, 4, 8))))
    if rng.random() < 0.003:
        stream *= 1 + 5000 // (len(stream) + 1)
    status = rng.choice((True, True, False, None))
    framer = Framer(status=status)
    found = []
    for piece in pieces(rng, stream):
        found += framer.feed(piece)
        assert len(framer) <= p.CAPACITY, len(framer)
    for each in found:
        assert each.intact
        assert status is None or (each.instruction == p.STATUS) is status
    # Noise with a right CRC may lack stuffing where twind would have sent it.
    bare = sum(len(p.instruction(each.id, each.instruction)) + len(each.params) for each in found)
    stuffed = sum(len(p.instruction(each.id, each.instruction, each.params)) for each in found)
    assert bare <= len(stream) - framer.discarded - len(framer) <= stuffed
    last = p.ping(9) if status is False else p.status(9, 0, b"\x01")
    told = framer.feed(last)
    if told and told[-1].id != 9:  # what had been cut off took its missing bytes from this one
        told = framer.feed(last)
    assert told and told[-1].id == 9, "a sound packet behind noise was not found"
    reporting = Framer(status=status, broken=True)
    assert [each for piece in pieces(rng, stream) for each in reporting.feed(piece) if each.intact] == found


def _round_trip(rng: Random) -> None:
    """P3: what is built is found, as it was meant, in any pieces."""
    id = rng.randrange(253)
    code = rng.choice(list(p.Instruction))
    params = _params(rng)
    params = (params or b"\0") if code == p.STATUS else params
    data = p.instruction(id, code, params)
    framer = Framer(status=None)
    found = [each for piece in pieces(rng, data) for each in framer.feed(piece)]
    assert [(each.id, each.instruction, each.params) for each in found] == [(id, code, params)]
    assert framer.discarded == len(framer) == 0
    assert p.unstuff(p.stuff(params)) == params


def _reply(rng: Random) -> None:
    """Replies that are due: only what is sound is taken, whole devices only, and the buffer is never full."""
    ids = tuple(rng.sample(range(253), rng.choice((1, 2, 5))))
    size = rng.choice((1, 10))
    blocks = {id: rng.randbytes(size) for id in ids}
    if rng.random() < 0.5:
        reply: StatusReply | FastSyncReadReply = StatusReply(ids, size)
        good = b"".join(p.status(id, 0, blocks[id]) for id in ids)
    else:
        reply = FastSyncReadReply(ids, size)
        good = b"".join(p.fast_status([(0, id, blocks[id]) for id in ids], len(ids) * (size + 4) + 1))
    before = _part(rng) if rng.random() < 0.5 else b""
    stream = before + mangled(rng, good)
    forged = {each.id for each in Framer(status=True).feed(before)}  # sound, so nobody can know
    reply.start()
    done = False
    for piece in pieces(rng, stream):
        while piece and not done:
            room = reply.receive_buffer()
            assert len(room) > 0, "no room, and not done"
            count = min(len(room), len(piece))
            room[:count] = piece[:count]
            done = reply.take(count)
            piece = piece[count:]
    reply.end()
    for place, id in enumerate(ids):
        if reply.heard[place] and good in stream and id not in forged:
            assert reply.data[place].tobytes() == blocks[id]
        if not reply.heard[place]:
            assert not reply.data[place].any(), "data of a device that was not heard"
    if stream == good:
        assert reply.heard.all() and reply.whole and reply.strays == 0
