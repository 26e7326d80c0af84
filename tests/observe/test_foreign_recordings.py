"""Whatever stands in place of a recording, every reader ends in one line that names it, and reads no more."""

import os
import resource
import signal
import socket
import struct
import zlib
from collections.abc import Callable, Iterator
from math import inf, nan
from pathlib import Path
from random import Random
from typing import Any

import msgspec
import pytest

from tests.proof.fuzz.recordings import Recordings
from tests.support.golden_captures import HERE
from twind.command_line.verb import Rejected
from twind.ctl.ctl_main import main as ctl
from twind.exceptions import InvalidInput
from twind.flight import EntryKind, FlightContents, FlightEntry, about, load, save
from twind.flight import flight_file as layout
from twind.link import decode_command, decode_news
from twind.observe.export import export
from twind.observe.recording import open_recording
from twind.observe.recover import recover

CAPTURE = HERE / "limit.flight"
READERS: dict[str, Callable[[Path], object]] = {
    "plot, gap, identify, dataset, tune, replay --view": open_recording,
    "export": lambda path: export(path, path.with_name("out.mcap")),
    "recover": lambda path: recover(path),
    "replay": load,
    "flight folder": about,
}
KINDS = ("pipe", "folder", "device", "socket", "dangling link", "link to a pipe")


@pytest.fixture
def within_a_minute() -> Iterator[None]:
    def late(number: int, frame: object) -> None:
        raise AssertionError("a reader waits")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def odd_file(folder: Path, kind: str, suffix: str) -> Path:
    path = folder / f"odd{suffix}"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "dangling link":
        path.symlink_to("nothing")
    elif kind == "link to a pipe":
        os.mkfifo(folder / "pipe")
        path.symlink_to("pipe")
    else:
        with socket.socket(socket.AF_UNIX) as end:
            end.bind(str(path))
    return path


@pytest.mark.usefixtures("within_a_minute")
@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("suffix", [".mcap", ".flight"])
def test_what_is_no_regular_file_is_refused_without_waiting(
    tmp_path: Path, reader: str, kind: str, suffix: str
) -> None:
    path = odd_file(tmp_path, kind, suffix)
    with pytest.raises((Rejected, InvalidInput, OSError), match=r"odd\."):
        READERS[reader](path)


@pytest.mark.usefixtures("within_a_minute")
def test_a_pipe_in_place_of_a_recording_ends_a_command_with_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = odd_file(tmp_path, "pipe", ".flight")
    for verb in (["plot"], ["export", str(tmp_path / "out.mcap")], ["recover"], ["replay"]):
        assert ctl([verb[0], str(path), *verb[1:]]) == 1
        assert "odd.flight: is a pipe, not a file" in capsys.readouterr().err


def test_a_flight_file_is_refused_by_its_head_before_the_rest_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.flight"
    path.write_bytes(CAPTURE.read_bytes())
    os.truncate(path, 6 << 30)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InvalidInput, match=r"\d+ bytes lie behind its end; copy it from the robot again"):
        load(path)
    path.write_bytes(layout.MAGIC + bytes(8))
    os.truncate(path, 6 << 30)
    with pytest.raises(InvalidInput):
        load(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 << 10  # KiB


def with_head(path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """A capture whose head is changed, with the right checksum."""
    data = CAPTURE.read_bytes()
    begin = len(layout.MAGIC)
    size, _ = struct.unpack_from("<II", data, begin)
    head = msgspec.msgpack.decode(data[begin + 8 : begin + 8 + size])
    change(head)
    made = msgspec.msgpack.encode(head)
    start = struct.pack("<II", len(made), zlib.crc32(made))
    path.write_bytes(layout.MAGIC + start + made + data[begin + 8 + size :])
    return path


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("buses", 1), ("buses", [1]), ("wall_ns", -1e18), ("wall_ns", -1), ("wall_ns", 2**63), ("mode", 1)),
        *(("monotonic", nan), ("monotonic", inf), ("monotonic", -1.0), ("monotonic", "x"), ("robot", [])),
    ],
)
def test_a_head_of_another_form_with_a_right_checksum_is_refused_by_every_reader(
    tmp_path: Path, key: str, value: object
) -> None:
    path = with_head(tmp_path / "a.flight", lambda head: head["meta"].update({key: value}))
    for name, reader in READERS.items():
        if name != "recover":
            with pytest.raises(
                (Rejected, InvalidInput), match=rf"a\.flight: its head has another format .*{key}"
            ):
                reader(path)


def test_sections_that_claim_more_than_a_recorder_holds_are_refused_unread(tmp_path: Path) -> None:
    def claim(head: dict[str, Any]) -> None:
        head["sections"] = [[name, layout.MOST, size] for name, _, size in head["sections"]]

    with pytest.raises(InvalidInput, match=f"its sections claim .* bytes: at most {layout.MOST}"):
        load(with_head(tmp_path / "a.flight", claim))


@pytest.mark.parametrize("time", [nan, inf, -1.0, 1e300])
def test_a_time_that_no_clock_has_is_refused(tmp_path: Path, time: float) -> None:
    flight = load(CAPTURE)
    entries = (FlightEntry(time, EntryKind.PORT, 0, b"opened /dev/x"), *flight.contents.entries)
    contents = FlightContents({}, entries)
    save(tmp_path / "a.flight", flight.meta, msgspec.msgpack.encode(flight.briefing), contents)
    with pytest.raises(InvalidInput, match="byte 0 of its records has the time"):
        load(tmp_path / "a.flight")


def test_a_message_that_is_no_text_is_one_that_is_not_understood() -> None:
    for decode in (decode_news, decode_command):
        for data in (b"\xa1\xff", b"\x81\xa4type\xa4\xff\xff\xff\xff", b"\x81\xa1a" * 5000):
            with pytest.raises(msgspec.DecodeError):
                decode(data)


def test_some_mutated_recordings_are_read_or_refused_in_one_line() -> None:
    files = Recordings()
    try:
        for number in range(40):
            files.one(Random(f"recordings short {number}"))
    finally:
        files.close()
    assert files.accepted > 8
