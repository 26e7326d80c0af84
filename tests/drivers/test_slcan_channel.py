"""slcan: what is a frame comes through unchanged, what is none is dropped and counted; nothing lingers."""

from collections.abc import Callable
from itertools import pairwise
from math import inf

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.driver_rig import is_output_full
from tests.support.examples import examples
from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.byte_transport import output_full
from twind_drivers.ports.channel import CanErrorState
from twind_drivers.ports.frame import ERROR, EXTENDED, FRAME, REMOTE, Frames, frames
from twind_drivers.ports.slcan_channel import RATES, SlcanChannel, opening
from twind_drivers.ports.slcan_codec import PATIENCE, SlcanDecoder, encode
from twind_drivers.ports.transmit_stall import TransmitStall

MANY = examples(100)


@st.composite
def one_frame(draw: st.DrawFn) -> tuple[int, bytes, int]:
    """Id with its flags, data, size."""
    extended = draw(st.booleans())
    remote = draw(st.booleans())
    id = draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF))
    data = b"" if remote else draw(st.binary(max_size=8))
    size = draw(st.integers(0, 8)) if remote else len(data)
    return id | (EXTENDED if extended else 0) | (REMOTE if remote else 0), data, size


def made(rows: list[tuple[int, bytes, int]]) -> Frames:
    found = np.zeros(len(rows), FRAME)
    for place, (id, data, size) in enumerate(rows):
        found[place]["id"] = id
        found[place]["size"] = size
        found[place]["data"][: len(data)] = list(data)
    return found


def cycle(count: int, *, extended: bool = False) -> Frames:
    """A cycle's answers: 8 bytes each."""
    data = np.random.default_rng(count).integers(0, 256, (count, 8), dtype=np.uint8)
    return frames(np.arange(1, count + 1, dtype=np.uint32) | (EXTENDED if extended else 0), data)


# ------------------------------------------------------------------------------------- the codec


def test_lines_are_as_the_adapters_manual_prints_them() -> None:
    rows = made([(0x1FF, b"\xab\x01", 2), (0x00000123 | EXTENDED, b"", 0), (0x7FF | REMOTE, b"", 3)])
    assert encode(rows) == b"t1FF2AB01\rT000001230\rr7FF3\r"
    assert encode(made([(0x1ABCDEF0 | EXTENDED | REMOTE, b"", 8)])) == b"R1ABCDEF08\r"
    assert encode(cycle(0)) == b""


@MANY
@given(st.lists(one_frame(), max_size=30), st.lists(st.integers(0, 900), max_size=6))
def test_every_frame_comes_through_in_its_order_however_the_bytes_are_cut(
    rows: list[tuple[int, bytes, int]], cuts: list[int]
) -> None:
    sent = made(rows)
    lines = SlcanDecoder()
    text = encode(sent)
    places = sorted({0, *cuts, 2000})
    parts = [lines.take(text[begin:end]) for begin, end in pairwise(places)]
    assert np.concatenate(parts).tobytes() == sent.tobytes()
    assert (lines.errors, lines.refused, lines.pending_size) == (0, 0, 0)


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("count", [1, 2, 24])
def test_a_cycle_of_one_kind_is_the_same_as_its_lines_one_by_one(count: int, extended: bool) -> None:
    sent = cycle(count, extended=extended)
    text = encode(sent)
    together = SlcanDecoder()
    assert text == b"".join(encode(sent[place : place + 1]) for place in range(count))
    assert together.take(text.lower().replace(b"t", b"T" if extended else b"t")).tobytes() == sent.tobytes()
    one_by_one = SlcanDecoder()
    assert b"".join(one_by_one.take(bytes([each])).tobytes() for each in text) == sent.tobytes()


@given(st.lists(st.binary(max_size=400), max_size=8))
@example([b"t" * 2000, b"\r"])
@examples(100)
def test_no_bytes_raise_and_none_are_kept_for_long(chunks: list[bytes]) -> None:
    lines = SlcanDecoder()
    for chunk in chunks:
        for frame in lines.take(chunk):
            assert frame["size"] <= 8
            assert not frame["data"][int(frame["size"]) :].any()
            assert not int(frame["id"]) & ERROR
        assert lines.pending_size <= PATIENCE
    assert lines.take(b"\rt1231FF\r")[-1]["data"][0] == 0xFF  # and the next whole line is understood


LINE = st.text("tTrR0123456789ABCDEFabcdefzF \x80", max_size=30).map(lambda text: text.encode("latin-1"))


@given(st.lists(LINE, max_size=30))
@examples(100)
def test_an_accepted_slcan_line_encodes_back_to_itself(texts: list[bytes]) -> None:
    lines = SlcanDecoder()
    found = lines.take(b"".join(text + b"\r" for text in texts))
    said = [text[:1] + text[1:].upper() for text in texts]
    for line in encode(found).split(b"\r")[:-1]:
        said.remove(line)
    assert len(found) + lines.errors + lines.acknowledged <= len(texts)


@pytest.mark.parametrize(
    "line",
    [
        b"t12",  # cut short
        b"T1234567",
        b"t",
        b"t1238AABB",  # says eight bytes, has two
        b"t1239" + b"AA" * 9,  # a DLC that is none
        b"t12320AABB",  # shifted
        b"t12G1AA",
        b"t1231A\x80",
        b"t1231A ",
        b"t1238AABBCCDDEETT1122",  # letters of lines in place of digits
        b"t1238AABBCCDDEEtt1122",
        b"T000001238AABBCCDDEETT1122",
        b"t 231AA",
        b"t1232AABBt1232CCDD",  # two run together
        b"t8001AA",  # beyond 11 bits
        b"T200000001AA",  # beyond 29 bits
        b"r1232AABB",  # a request has no data
        b"d1231AA",  # CAN FD
        b"t1231AA\n",
        b"FGG",
        b"\xff",
    ],
)
def test_a_line_that_is_no_frame_is_dropped_and_counted_and_harms_no_other(line: bytes) -> None:
    for company in (b"", encode(cycle(3)), encode(cycle(2, extended=True))):
        lines = SlcanDecoder()
        found = lines.take(company + line + b"\r" + company)
        assert encode(found) == company * 2, company
        assert (lines.errors, lines.pending_size) == (1, 0), company


def test_a_line_without_end_is_given_up_and_its_tail_is_no_line() -> None:
    lines = SlcanDecoder()
    assert not len(lines.take(b"x" * (PATIENCE + 1)))
    assert (lines.pending_size, lines.errors) == (0, 1)
    assert not len(lines.take(b"t1231AA"))  # still the same line
    assert [int(each) for each in lines.take(b"\rt1241BB\r")["id"]] == [0x124]
    assert lines.errors == 1


def test_adapter_replies_are_distinguished_from_frames() -> None:
    lines = SlcanDecoder()
    found = lines.take(b"\rz\rZ\r\x07t1231AA\r\x07V1013\rN1234\rFA4\rF\r")
    assert len(found) == 1
    assert (lines.acknowledged, lines.refused, lines.flags) == (3, 2, 0xA4)
    assert lines.errors == 1  # the bare F


def test_acknowledgements_around_a_cycle_are_counted_and_taken_off() -> None:
    lines = SlcanDecoder()
    assert lines.take(b"z\r" * 23 + b"z").tobytes() == b""
    assert lines.take(b"\r\rZ\r" + encode(cycle(24))).tobytes() == cycle(24).tobytes()
    assert (lines.acknowledged, lines.errors) == (26, 0)
    each = [encode(cycle(3)[place : place + 1]) for place in range(3)]
    assert lines.take(b"z\r".join(each) + b"z\r\rt12").tobytes() == cycle(3).tobytes()
    assert (lines.acknowledged, lines.errors, lines.pending_size) == (30, 0, 3)
    assert lines.take(b"z\r" + encode(cycle(2))).tobytes() == cycle(2).tobytes()  # run into one another
    assert (lines.acknowledged, lines.errors) == (30, 1)
    lines.take(b"zzz\r")
    assert (lines.acknowledged, lines.errors) == (30, 2)


@pytest.mark.parametrize(("id", "size"), [(0x800, 1), (1 | ERROR, 8), (1, 9), (0x3FFFFFFF | EXTENDED, 0)])
def test_an_invalid_frame_is_not_sent(id: int, size: int) -> None:
    wrong = cycle(3)
    wrong[1]["id"] = id
    wrong[1]["size"] = size
    with pytest.raises(ValueError, match="frame 1"):
        encode(wrong)


# ------------------------------------------------------------------------------------- the channel


class Adapter:
    """A transport whose other end is an adapter: what it was told, what it says, and how full it is."""

    def __init__(self, *, holds: bool = True) -> None:
        self.name = "adapter"
        self.warning = ""
        self.holds = holds
        self.told = b""
        self.says = b""
        self.moves = True  # bytes leave the port
        self.waiting = 0
        self.capacity = 4096
        self.error: Exception | None = None
        self.flushes = 0
        self.closed = False

    def fileno(self) -> int:
        return -1

    def arrival(self) -> float:
        return 0.0 if self.says else inf

    def write(self, data: bytes | bytearray | memoryview) -> None:
        if self.error:
            raise self.error
        if not self.moves:
            if self.waiting + len(data) > self.capacity:
                waiting = self.waiting
                self.flush()
                raise output_full(self.name, waiting, len(data))
            self.waiting += len(data)
        self.told += bytes(data)

    def read_into(self, buffer: memoryview) -> int:
        if self.error:
            raise self.error
        count = min(len(buffer), len(self.says))
        buffer[:count] = self.says[:count]
        self.says = self.says[count:]
        return count

    def settle(self) -> None:
        pass

    def drain(self, thrown: bytearray | None = None) -> int:
        count = len(self.says)
        self.says = b""
        return count

    def backlog(self) -> int:
        return self.waiting

    def flush(self) -> None:
        if self.error:
            raise self.error
        self.flushes += 1
        self.waiting = 0

    def close(self) -> None:
        self.closed = True


def opened(adapter: Adapter) -> SlcanChannel:
    """Open, and past the time in which answers belong to the opening."""
    channel = SlcanChannel(adapter, 1_000_000)
    channel.receive(0.0)
    adapter.told = b""
    return channel


def lost_at(adapter: Adapter, *, stuck_until: float) -> float | None:
    """Return the time when a channel that sends 100 times a second reports a lost port; None: never."""
    channel = opened(adapter)
    for tick in range(1, 300):
        now = tick * 0.01
        adapter.moves = now >= stuck_until
        if adapter.moves:
            adapter.waiting = 0
        try:
            channel.send(cycle(24), now)
        except PortError as error:
            if error.lost:
                return now
    return None


def test_opening_an_adapter_closes_it_first_sets_the_rate_and_waits_for_no_reply() -> None:
    adapter = Adapter()
    adapter.says = b"t1231AA\rhalf a li"
    channel = SlcanChannel(adapter, 500_000)
    assert adapter.told == b"\r\rC\rS6\rO\r"
    assert not len(channel.receive(0.0))  # what was said before belongs to nobody
    assert channel.name == "adapter"


def test_rates_are_those_of_slcan_and_another_is_refused_with_the_list() -> None:
    assert [opening(rate) for rate in RATES][-1] == b"\r\rC\rS8\rO\r"
    with pytest.raises(PortError, match=r"bitrate 300000 is not a bitrate of slcan: 10000, .* 1000000") as no:
        SlcanChannel(Adapter(), 300_000)
    assert not no.value.lost


def test_a_cycle_leaves_in_one_write_and_its_answers_come_as_one_array() -> None:
    adapter = Adapter()
    channel = opened(adapter)
    sent = cycle(24)
    channel.send(sent, 0.01)
    assert adapter.told == encode(sent)
    adapter.says = b"z\r" * 24 + encode(sent)
    assert channel.receive(0.011).tobytes() == sent.tobytes()
    assert (channel.condition.line, channel.condition.refused, channel.condition.errors) == (0, 0, 0)
    channel.send(sent[:0], 0.02)
    assert adapter.told == encode(sent)


def test_more_frames_than_one_read_holds_all_come() -> None:
    adapter = Adapter()
    channel = opened(adapter)
    adapter.says = encode(cycle(1000))
    assert channel.receive(0.1).tobytes() == cycle(1000).tobytes()


def test_a_packet_that_has_not_left_when_the_next_but_one_is_due_is_thrown_away_with_it() -> None:
    adapter = Adapter()
    channel = opened(adapter)
    adapter.moves = False
    channel.send(cycle(24), 0.01)
    channel.send(cycle(24), 0.02)
    adapter.told = b""
    with pytest.raises(PortError, check=is_output_full):
        channel.send(cycle(24), 0.03)
    assert adapter.told == b"\r\rC\rS8\rO\r"  # nothing of the cycle; the adapter's own queue is emptied too
    assert channel.condition.refused == 24


def test_a_port_that_takes_nothing_for_a_second_is_lost_and_one_that_moves_again_is_not() -> None:
    assert lost_at(Adapter(), stuck_until=0.9) is None
    found = lost_at(Adapter(), stuck_until=inf)
    assert found is not None
    assert 1.0 <= found <= 1.1


def test_a_terminal_without_a_reader_is_lost_after_a_second() -> None:
    found = lost_at(Adapter(holds=False), stuck_until=inf)
    assert found is not None
    assert 1.0 <= found <= 1.3


def test_an_adapter_that_refuses_on_an_idle_wire_is_off_and_lost_after_a_second() -> None:
    adapter = Adapter()
    channel = opened(adapter)

    def tick(now: float) -> CanErrorState:
        channel.send(cycle(4), now)
        adapter.says = b"\x07" * 4
        channel.receive(now)
        return channel.condition.line

    lines = [tick(0.2 + place * 0.01) for place in range(100)]
    assert lines.index(CanErrorState.OFF) in (10, 11)  # refused for 0.1 s
    with pytest.raises(PortError, match="power of the actuators") as lost:
        tick(1.21)
    assert lost.value.lost
    assert channel.condition.refused == 404
    assert adapter.told.endswith(b"C\rS8\rO\r")  # its queue is emptied before the port is given up


def test_refusals_among_frames_are_congestion_and_no_more() -> None:
    adapter = Adapter()
    channel = opened(adapter)
    for tick in range(20, 400):
        adapter.says = b"\x07" + encode(cycle(2))
        channel.receive(tick * 0.01)
        assert channel.condition.line is CanErrorState.ACTIVE
    assert channel.condition.refused == 380


def test_a_received_frame_returns_the_line_to_active() -> None:
    adapter = Adapter()
    channel = opened(adapter)
    for tick in range(20, 40):
        adapter.says = b"\x07"
        channel.receive(tick * 0.01)
    assert channel.condition.line is CanErrorState.OFF
    adapter.says = encode(cycle(1))
    channel.receive(0.4)
    assert channel.condition.line is CanErrorState.ACTIVE


def test_refusals_during_opening_do_not_count_against_the_line() -> None:
    adapter = Adapter()
    channel = SlcanChannel(adapter, 1_000_000)
    adapter.says = b"\x07\r\r\x07"
    channel.receive(0.0)
    adapter.says = b"\x07"
    channel.receive(0.09)
    assert channel.condition.refused == 0


def test_flags_are_polled_ten_times_a_second_only_from_an_adapter_that_reports_them() -> None:
    silent = Adapter()
    telling = Adapter()
    for adapter in (silent, telling):
        channel = SlcanChannel(adapter, 1_000_000)
        for tick in range(500):
            adapter.says += b"t1231AA\r" + (b"F00\r" if adapter is telling else b"")
            channel.receive(tick * 0.01)
    assert silent.told.count(b"F\r") == 1
    assert 45 <= telling.told.count(b"F\r") <= 50


def test_the_passive_flag_is_set_and_cleared_and_a_wire_error_is_counted() -> None:
    adapter = Adapter()
    channel = opened(adapter)
    adapter.says = b"F20\r"
    channel.receive(0.1)
    assert (channel.condition.line, channel.condition.errors) == (CanErrorState.PASSIVE, 0)
    adapter.says = b"F84\r"  # warning level, and errors on the wire: neither is a state
    channel.receive(0.2)
    assert (channel.condition.line, channel.condition.errors) == (CanErrorState.ACTIVE, 1)


def test_an_adapter_still_starting_is_opened_again_until_it_replies() -> None:
    adapter = Adapter()
    channel = SlcanChannel(adapter, 1_000_000)
    for tick in range(200):
        channel.receive(tick * 0.01)
    assert adapter.told.count(b"S8\r") == 4  # at 0, 0.5, 1, 1.5 s
    adapter.says = b"\r"
    for tick in range(200, 1000):
        channel.receive(tick * 0.01)
    assert adapter.told.count(b"S8\r") == 4
    mute = Adapter()
    channel = SlcanChannel(mute, 1_000_000)
    for tick in range(3000):
        channel.receive(tick * 0.01)
    assert mute.told.count(b"S8\r") == 11  # a mute one is not told for ever


def test_closing_a_channel_empties_both_queues_and_never_raises() -> None:
    adapter = Adapter()
    channel = opened(adapter)
    channel.close()
    channel.close()
    assert (adapter.flushes, adapter.told, adapter.closed) == (1, b"\r\rC\r", True)
    gone = Adapter()
    channel = opened(gone)
    gone.error = PortError("adapter", "hung up", kind=PortErrorCause.LOST)
    channel.close()
    assert gone.closed


@pytest.mark.parametrize(
    "act",
    [
        lambda channel: channel.send(cycle(1), 1.0),
        lambda channel: channel.receive(1.0),
        lambda channel: channel.purge(),
    ],
)
def test_a_removed_adapter_raises_a_lost_port_error(act: Callable[[SlcanChannel], object]) -> None:
    adapter = Adapter()
    channel = opened(adapter)
    adapter.error = PortError("adapter", "hung up (adapter unplugged?)", kind=PortErrorCause.LOST)
    with pytest.raises(PortError, match="unplugged") as lost:
        act(channel)
    assert lost.value.lost


# ------------------------------------------------------------------------------------- the judge of a stall


@given(st.lists(st.floats(0.001, 0.9), min_size=1, max_size=50))
def test_a_stall_is_as_long_as_since_something_was_taken(gaps: list[float]) -> None:
    stall = TransmitStall()
    now = 0.0
    waited = 0.0
    for gap in gaps:
        now += gap
        waited = stall.record_refusal(now)
        assert stall.is_blocked
    assert waited == pytest.approx(now - gaps[0])
    stall.record_acceptance()
    assert not stall.is_blocked
    assert stall.record_refusal(now + 0.1) == 0.0


def test_an_emptied_queue_stays_blocked_until_a_frame_is_received() -> None:
    stall = TransmitStall()
    for tick in range(20):
        stall.record_refusal(tick * 0.01)
    assert stall.blocked
    stall.emptied()
    stall.record_acceptance()
    assert stall.blocked
    assert stall.record_refusal(0.3) == pytest.approx(0.3)
    stall.record_reception(0.4)
    stall.record_acceptance()
    assert not stall.blocked
    assert stall.record_refusal(0.5) == 0.0


def test_a_refusal_long_ago_is_another_story() -> None:
    stall = TransmitStall()
    assert stall.record_refusal(0.0) == 0.0
    assert stall.record_refusal(5.0) == 0.0
    assert not stall.blocked
