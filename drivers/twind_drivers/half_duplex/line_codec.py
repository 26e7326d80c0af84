"""Packets of a line's protocol, as readers and writers of register tables use them. Pure."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from twind_drivers.half_duplex import checksum_packet
from twind_drivers.half_duplex.checksum_reply import ChecksumReply
from twind_drivers.half_duplex.pending_reply import PacketFramer, PendingReply


@dataclass(frozen=True, slots=True)
class LineCodec:
    """Packets of one protocol. `overhead`: bytes of a status without data; `broadcast`: id of all devices."""

    overhead: int
    request: int  # bytes of a request to one device, without data
    broadcast: int
    find_packets: PacketFramer
    write: Callable[[int, int, bytes], bytes]  # id, address, data
    sync_write: Callable[[int, Mapping[int, bytes]], bytes]  # address, data by id
    confirmation: Callable[[Sequence[int], int], PendingReply]  # status of these ids, of so many data bytes


CHECKSUM = LineCodec(
    overhead=checksum_packet.OVERHEAD,
    request=8,
    broadcast=checksum_packet.BROADCAST,
    find_packets=checksum_packet.find_packets,
    write=checksum_packet.write,
    sync_write=checksum_packet.sync_write,
    confirmation=ChecksumReply,
)
