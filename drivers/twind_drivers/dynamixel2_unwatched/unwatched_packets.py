"""Packets of Protocol 2.0 as readers and writers of register tables use them. Pure."""

from twind_drivers.bus import PingRequest, Query
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.replies import StatusReply
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction
from twind_drivers.half_duplex.line_codec import LineCodec

PROTOCOL2 = LineCodec(
    overhead=packet.STATUS_OVERHEAD,
    request=14,
    broadcast=packet.BROADCAST,
    find_packets=packet.find_packets,
    write=packet.write,
    sync_write=packet.sync_write,
    confirmation=StatusReply,
)


def plain_transaction(query: Query) -> SerialTransaction:
    """Return the ping, the read of one device, or the sync read of several; each device sends a status."""
    if isinstance(query, PingRequest):
        return SerialTransaction(packet.ping(query.id), StatusReply((query.id,), 3), 1)
    reply = StatusReply(query.ids, query.size)
    if len(query.ids) == 1:
        request = packet.read(query.ids[0], query.address, query.size)
    else:
        request = packet.sync_read(query.ids, query.address, query.size)
    return SerialTransaction(request, reply, len(query.ids))
