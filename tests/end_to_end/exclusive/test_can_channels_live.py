"""Real-time tests of can channels."""

import os

from can.interfaces.slcan import slcanBus

from tests.support.can_channels_rig import Terminal
from tests.support.can_frames import messages_of, mixed, received_frames, same
from twind_drivers.ports.can_ports import open_channel
from twind_drivers.ports.slcan_codec import encode

OPENING = b"\r\rC\rS8\rO\r"


def test_our_slcan_and_python_cans_understand_each_other_on_the_two_ends_of_one_wire() -> None:
    ours = Terminal()
    theirs = Terminal()
    channel = open_channel(f"can:slcan:{ours.path}", 1_000_000)
    bus = slcanBus(theirs.path, bitrate=1_000_000, sleep_after_open=0.0)
    try:
        ours.received(len(OPENING))
        assert theirs.received(10) == b"C\rS8\r\rO\rO\r"
        for message in messages_of(mixed()):
            bus.send(message)
        os.write(ours.master, theirs.received(len(encode(mixed()))))
        assert received_frames(channel, 12).tobytes() == mixed().tobytes()
        channel.send(mixed(), 0.0)
        os.write(theirs.master, ours.received(len(b"F\r" + encode(mixed()))))  # the question harms nobody
        for wanted in messages_of(mixed()):
            message = bus.recv(timeout=2.0)
            assert message is not None
            assert same(message, wanted)
        assert channel.condition.errors == 0
    finally:
        bus.shutdown()
        channel.close()
        ours.unplug()
        theirs.unplug()
