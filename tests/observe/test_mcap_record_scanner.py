"""Records of .mcap files: whole ones as the library reads them, cut ones as far as they go."""

import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from lz4 import frame
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Message, Metadata
from mcap.writer import CompressionType, Writer

from tests.support.sample_recordings import SESSION, write
from twind.exceptions import InvalidInput
from twind.observe.recording.mcap_record_scanner import LARGEST, McapRecordScanner


def messages(path: Path) -> tuple[McapRecordScanner, list[Message]]:
    file = McapRecordScanner(path)
    return file, [each for each in file.contents() if isinstance(each, Message)]


def of_the_library(path: Path) -> list[tuple[str, int, int, bytes]]:
    with path.open("rb") as stream:
        read = make_reader(stream).iter_messages(log_time_order=False)
        return [(channel.topic, each.log_time, each.sequence, each.data) for _, channel, each in read]


def test_a_whole_file_is_what_the_library_reads(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", 2.0)
    file, found = messages(path)
    assert not file.cut and not file.damaged and file.kept == file.size and file.profile == "ros2"
    rows = [(file.channels[each.channel_id].topic, each.log_time, each.sequence, each.data) for each in found]
    assert rows == of_the_library(path) and len(rows) == 400 + 4
    others = [each for each in McapRecordScanner(path).contents() if not isinstance(each, Message)]
    assert [each.name for each in others] == ["twind", "robot.json", "model.mjcf"]
    assert isinstance(others[0], Metadata) and others[0].metadata == SESSION.about
    assert isinstance(others[1], Attachment) and others[1].data == b'{"name": "two"}'


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunking", [True, False])
def test_any_way_to_write_one_is_read(tmp_path: Path, compression: CompressionType, chunking: bool) -> None:
    path = tmp_path / "b.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=200, compression=compression, use_chunking=chunking)
        writer.start()
        channel = writer.register_channel("/x", "", 0)
        for time in range(100):
            writer.add_message(channel, time, b"x" * time, time, time)
        writer.finish()
    file, found = messages(path)
    assert not file.cut and [each.data for each in found] == [b"x" * time for time in range(100)]


def test_a_file_cut_at_any_byte_yields_all_complete_records_and_the_position_of_its_end(
    tmp_path: Path,
) -> None:
    whole = write(tmp_path / "c.mcap", 1.0)
    data = whole.read_bytes()
    all_of_it = messages(whole)[1]
    cut = tmp_path / "cut.mcap"
    counts = set()
    for end in [*range(8, len(data), 97), *range(len(data) - 40, len(data))]:
        cut.write_bytes(data[:end])
        file, found = messages(cut)
        assert found == all_of_it[: len(found)]
        assert file.cut and file.kept <= end
        counts.add(len(found))
    assert counts == {0, 101, 202}  # chunk by chunk: 50 readings, commands and one of what is slow each


def zeros(data: bytes) -> bytes:
    return data + bytes(4096)  # what a power cut leaves of a file that was growing


def garbage(data: bytes) -> bytes:
    return data + b"\x06" + bytes(range(200))


@pytest.mark.parametrize("tail", [zeros, garbage])
def test_bytes_left_by_a_power_cut_after_the_end_are_not_read_as_records(
    tmp_path: Path, tail: Callable[[bytes], bytes]
) -> None:
    path = write(tmp_path / "d.mcap", 1.0)
    data = path.read_bytes()
    second = data.index(b"zstd", data.index(b"zstd") + 4)
    path.write_bytes(tail(data[: second + 100]))
    file, found = messages(path)
    assert len(found) == 101 and "not whole" in file.cut and file.damaged in (0, 1)


def test_a_chunk_that_was_damaged_is_left_out_and_the_others_are_read(tmp_path: Path) -> None:
    path = write(tmp_path / "e.mcap", 1.0)
    data = bytearray(path.read_bytes())
    first = data.index(b"zstd") + 40
    for place in range(first, len(data), 7):
        data[place] ^= 0x10
        path.write_bytes(data)
        file, found = messages(path)
        assert file.damaged == 1 and len(found) in (0, 101)  # without the first the channels are unknown
        assert data[file.damage] == Opcode.CHUNK and file.damage < first < file.damage + 200
        data[place] ^= 0x10
        if place > first + 700:
            break


def test_a_file_that_is_no_mcap_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    path.write_bytes(b"no such thing")
    with pytest.raises(InvalidInput, match="is no MCAP file"):
        messages(path)


def chunk(compression: bytes, data: bytes, size: int) -> bytes:
    """A chunk that claims to hold `size` bytes."""
    head = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression
    body = head + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(body)) + body


def bombs() -> dict[str, bytes]:
    much = bytes(4 * LARGEST)
    zstd = zstandard.compress(much)
    lz4 = frame.compress(much)
    silent = zstandard.ZstdCompressor(write_content_size=False).compress(b"x")
    return {
        "zstd that says so": chunk(b"zstd", zstd, len(much)),
        "zstd that does not": chunk(b"zstd", zstd, 100),
        "lz4": chunk(b"lz4", lz4, 100),
        "a size that no machine has": chunk(b"zstd", silent, 1 << 60),
    }


def test_a_chunk_never_takes_more_memory_than_the_bound_whatever_its_declared_size(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.mcap", 0.5).read_bytes()
    path = tmp_path / "g.mcap"
    for name, bomb in bombs().items():
        path.write_bytes(whole[:8] + bomb + whole[8:])
        tracemalloc.start()
        file, found = messages(path)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert (file.damaged, file.cut, len(found)) == (1, "", 101), name
        assert peak < LARGEST, name


def test_a_record_larger_than_the_bound_is_left_out_and_what_follows_is_read(tmp_path: Path) -> None:
    path = tmp_path / "h.mcap"
    whole = write(tmp_path / "whole.mcap", 0.5).read_bytes()
    with path.open("wb") as stream:
        stream.write(whole[:8] + struct.pack("<BQ", 9, LARGEST + 1))
        stream.seek(LARGEST + 1, 1)  # a hole: nothing of it is on the disk
        stream.write(whole[8:])
    file, found = messages(path)
    assert (file.damaged, file.cut, len(found)) == (1, "", 101)
