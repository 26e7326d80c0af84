"""The front's end of the link: what must not be lost is sent again until the kernel takes it."""

import asyncio
import errno
import socket

from twind import link
from twind.front.loop_connection import LoopConnection

STOP = link.EStop(ticket=1, client=2, level="cut", reason="", more=False)


class ShortOfMemory(socket.socket):
    """A socket for whose messages the kernel has no memory at first."""

    failures = 3

    def send(self, data: bytes, flags: int = 0) -> int:  # type: ignore[override]
        if self.failures:
            self.failures -= 1
            raise OSError(errno.ENOBUFS, "No buffer space available")
        return super().send(data, flags)


async def _sent_to_the_loop() -> link.Inward:
    outer, inner = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    inner.settimeout(3.0)
    with inner, ShortOfMemory(fileno=outer.detach()) as short:
        front = LoopConnection(short, asyncio.get_running_loop(), lambda _: None, lambda: None)
        assert not front.send(link.Heartbeat())
        front.owe(STOP)
        data = await asyncio.to_thread(inner.recv, link.DATAGRAM)
        asyncio.get_running_loop().remove_reader(short)
        return link.decode_command(data)


def test_a_stop_for_which_the_kernel_has_no_memory_is_sent_again() -> None:
    assert asyncio.run(_sent_to_the_loop()) == STOP
