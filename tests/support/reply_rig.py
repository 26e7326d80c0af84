"""Replies of four devices as bytes, given to a reply in chunks."""

from twind_drivers.dynamixel import packet
from twind_drivers.half_duplex.pending_reply import PendingReply

IDS = (3, 7, 4, 250)
SIZE = 10


def block(id: int) -> bytes:
    """Data of that device."""
    return bytes((id + k) % 250 for k in range(SIZE))


def plain(ids: tuple[int, ...] = IDS, error: int = 0) -> bytes:
    """One status of each."""
    return b"".join(packet.status(id, error, block(id)) for id in ids)


def fast(count: int = len(IDS)) -> bytes:
    """The common status, with the blocks of the first devices alone."""
    rows = [(0, id, block(id)) for id in IDS[:count]]
    return b"".join(packet.fast_status(rows, len(IDS) * (SIZE + 4) + 1))


def give(reply: PendingReply, data: bytes, chunk: int = 4096) -> bool:
    """All of `data` in chunks; was it done before the last was taken?"""
    reply.start()
    done = False
    while data and not done:
        room = reply.receive_buffer()
        count = min(chunk, len(room), len(data))
        assert count > 0
        room[:count] = data[:count]
        done = reply.take(count)
        data = data[count:]
    reply.end()
    return done


def check_data(reply: PendingReply) -> None:
    """Data of each that is heard, zeros of the others."""
    for place, id in enumerate(reply.ids):
        wanted = block(id) if reply.heard[place] else bytes(SIZE)
        assert reply.data[place].tobytes() == wanted
