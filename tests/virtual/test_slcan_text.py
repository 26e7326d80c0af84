"""The slcan text of a virtual adapter: what it takes, what it answers, what it breaks on order."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_can_host import CanHost
from twind_drivers.ports.frame import EXTENDED, REMOTE
from twind_drivers.virtual.can.can_controller import CanAdapter
from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.can.slcan_text import KINDS, parsed

ENABLE = b"t0018FFFFFFFFFFFFFFFC\r"
TOLD = b"t0118117FFF7FF7FF1919\r"


class Adapter:
    """A host at the text end of one Damiao."""

    def __init__(self, *nodes: NodeSpec, adapter: CanAdapter | None = None) -> None:
        self.host = CanHost(nodes or [NodeSpec(1, "DM4310", 0x11)], adapter=adapter, opened=False)
        self.bus = self.host.bus
        self.clock = self.host.clock

    def ask(self, text: bytes, wait: float = 0.005) -> bytes:
        self.bus.receive(text, self.clock.now())
        heard = self.bus.take(self.clock.now())
        self.clock.sleep_until(self.clock.now() + wait)
        return heard + self.bus.take(self.clock.now())


def opened(*nodes: NodeSpec, adapter: CanAdapter | None = None) -> Adapter:
    made = Adapter(*nodes, adapter=adapter)
    assert made.ask(b"S8\rO\r") == b"\r\r"
    return made


def test_python_can_s_opening_is_understood() -> None:
    """Facts 10: `C S8`, an empty line, `O` twice; what is closed or open already is refused."""
    assert Adapter().ask(b"C\rS8\r\rO\rO\r") == b"\a\r\r\r\a"


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (b"V\r", b"V1013\r"),
        (b"N\r", b"NTWVC\r"),
        (b"F\r", b"F00\r"),
        (b"S8\r", b"\a"),
        (b"X1\r", b"\a"),
        (b"t00\r", b"\a"),
        (b"t0018FFFF\r", b"\a"),
        (b"t0019FFFFFFFFFFFFFFFFFF\r", b"\a"),
        (b"t8001FF\r", b"\a"),
        (b"T200000001FF\r", b"\a"),
        (b"t001G\r", b"\a"),
        (b"r0018FF\r", b"\a"),
        (b"\xff\xfe\r", b"\a"),
        (b"t" + b"0" * 200 + b"\r", b"\a"),
    ],
)
def test_each_line_has_its_answer(line: bytes, answer: bytes) -> None:
    host = opened()
    assert host.ask(line) == answer
    assert host.ask(ENABLE) == b"z\r" + TOLD, "and the next line is understood"


def test_while_closed_frames_are_dropped_in_both_directions() -> None:
    host = Adapter(NodeSpec(3, "ODrive"))
    assert host.ask(b"t0670\r", wait=1.0) == b"\a"
    assert host.ask(b"F\r") == b"\a"
    assert host.ask(b"O\r", wait=0.1).startswith(b"\rt06"), "heartbeats and estimates from now on"
    before = host.ask(b"C\r")
    assert before.endswith(b"\r")
    assert host.ask(b"", wait=1.0) == b""


def test_in_listen_only_mode_the_adapter_receives_and_refuses_to_send() -> None:
    host = Adapter(NodeSpec(3, "ODrive"), NodeSpec(4, "ODrive"))
    assert b"t061" in host.ask(b"L\r", wait=0.3)
    assert host.ask(b"t0670\r", wait=0.0) == b"\a"


def test_answers_may_be_switched_off() -> None:
    assert opened(adapter=CanAdapter(acknowledges=False)).ask(ENABLE) == TOLD


@given(st.lists(st.integers(1, 40), max_size=12))
def test_text_may_come_in_any_pieces(cuts: list[int]) -> None:
    host = opened()
    text = ENABLE * 3
    heard = b""
    for size in [*cuts, len(text)]:
        heard += host.ask(text[:size], wait=0.0)
        text = text[size:]
    heard += host.ask(b"", wait=0.01)
    assert (heard.count(b"z\r"), heard.count(TOLD)) == (3, 3)


@examples(100)
@given(st.lists(st.binary(max_size=40), max_size=8))
def test_no_bytes_break_the_adapter(pieces: list[bytes]) -> None:
    host = opened()
    for piece in pieces:
        host.ask(piece)
    host.ask(b"\r")
    host.ask(b"C\r")
    assert host.ask(b"S8\rO\r").endswith(b"\r\r")
    assert host.ask(ENABLE).endswith(TOLD)


frames = st.builds(
    CanMessage,
    st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda id: id | EXTENDED)),
    st.binary(max_size=8),
)


@given(frames, st.booleans())
def test_a_printed_frame_is_parsed_back_unchanged(message: CanMessage, remote: bool) -> None:
    if remote:
        message = CanMessage(message.id | REMOTE, bytes(len(message.data)))
    line = Adapter().bus.text.print([message])
    assert parsed(line[:-1]) == message
    assert line.endswith(b"\r")


@pytest.mark.parametrize("kind", KINDS)
def test_a_line_that_is_broken_on_order_is_no_frame_and_the_next_one_is(kind: str) -> None:
    host = opened()
    host.host.faults.corrupt(1, kind)
    broken = host.ask(b"t00187FFF7FF0000007FF\r").removeprefix(b"z\r")
    assert broken != TOLD
    assert all(parsed(line) is None for line in broken.split(b"\r") if line) or kind == "joined"
    again = host.ask(b"t00187FFF7FF0000007FF\r").removeprefix(b"z\r")
    assert again == b"t0118017FFF7FF7FF1919\r"


def test_joined_lines_are_no_frame_together() -> None:
    host = opened()
    host.host.faults.corrupt(1, "joined")
    heard = host.ask(ENABLE * 2, wait=0.01).replace(b"z\r", b"")
    assert heard == TOLD[:-1] + TOLD
    assert parsed(heard[:-1]) is None


def test_bus_off_shows_in_the_flags_and_reopening_ends_it() -> None:
    host = opened()
    host.host.faults.bus_off()
    assert host.ask(ENABLE) == b"z\r"
    assert host.ask(b"F\r") == b"FA4\r"
    assert host.ask(b"C\rO\r") == b"\r\r"
    assert host.ask(b"F\r") == b"F00\r"
    assert host.ask(ENABLE) == b"z\r" + TOLD


def test_closing_empties_the_queue_unless_the_adapter_is_made_otherwise() -> None:
    for keeps, left in ((False, b""), (True, TOLD)):
        host = opened(adapter=CanAdapter(keeps=keeps))
        host.host.faults.power(False)
        host.ask(ENABLE)
        assert host.ask(b"F\r") == b"FA4\r", "nobody acknowledges"
        host.ask(b"C\r")
        host.host.faults.power(True)
        host.ask(b"", wait=1.0)
        assert host.ask(b"O\r", wait=0.1) == b"\r" + left


def test_a_stalled_adapter_sends_its_backlog_when_it_resumes() -> None:
    host = opened()
    host.host.faults.stall()
    assert host.ask(ENABLE, wait=0.5) == b""
    host.host.faults.stall(False)
    assert host.ask(b"") == b"z\r" + TOLD


def test_a_replugged_adapter_is_closed_and_empty() -> None:
    host = opened()
    host.bus.receive(ENABLE, 0.0)
    host.host.faults.unplug()
    assert host.ask(ENABLE) == b""
    host.host.faults.replug()
    assert host.ask(ENABLE) == b"\a"
    assert host.ask(b"S8\rO\r") == b"\r\r"
    assert not host.host.truth()["torque"], "what was under way is lost"


def test_an_error_frame_has_no_text() -> None:
    host = opened()
    host.host.faults.error_frames(5)
    host.host.faults.passive()
    assert host.ask(b"") == b""
    assert host.ask(b"F\r") == b"F24\r"


def test_an_adapter_with_batches_hands_over_at_their_ends_and_nothing_before() -> None:
    host = Adapter(adapter=CanAdapter(batch=0.001))
    bus = host.bus
    bus.receive(b"S8\rO\r" + ENABLE, 0.0002)
    heard = {}
    assert bus.take(0.0009) == b""
    while np.isfinite(due := bus.next_output_time()):
        assert bus.take(np.nextafter(due - 1e-9, 0.0)) == b""
        heard[round(due * 1e3, 6)] = bus.take(due)
    assert heard == {1.0: b"\r\rz\r" + TOLD}
    bus.receive(ENABLE, 0.00195)
    assert bus.take(0.002) == b"z\r"
    assert bus.take(0.0025) == b""
    assert bus.take(0.003) == TOLD
