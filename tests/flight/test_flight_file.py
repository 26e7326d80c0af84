"""A flight file is whole or none: what was saved is what is loaded, and a cut or foreign one is said so."""

import os
import stat
import zlib
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.briefing import Briefing, JointInfo
from twind.exceptions import InvalidInput
from twind.flight import EntryKind, FlightContents, FlightEntry, PackedFlight, about, load, pack, save
from twind.flight import flight_file as file_module
from twind.flight.flight_records import LAST

BRIEFING = Briefing(
    version="1",
    robot="h24",
    joints=[JointInfo("hip", "left", 1, True, -1.0, 1.0)],
    description={"name": "h24"},
    calibration=None,
    mjcf="<mujoco/>",
    rate_hz=100.0,
    parameters={},
)
BYTES = msgspec.msgpack.encode(BRIEFING)
META = {"reason": "test", "time": 12.5}
CONTENTS = FlightContents(
    {0: (FlightEntry(1.0, EntryKind.OUT, 0, b"who?"), FlightEntry(1.1, EntryKind.IN, 0, b"I"))},
    (
        FlightEntry(2.0, EntryKind.PORT, 0, b"opened /dev/ttyUSB0"),
        FlightEntry(2.5, EntryKind.NEWS, 255, bytes(range(200))),
    ),
)

entries = st.lists(
    st.builds(
        FlightEntry,
        st.floats(0.0, LAST),
        st.sampled_from(EntryKind),
        st.integers(0, 255),
        st.binary(max_size=200),
    ),
    max_size=20,
).map(tuple)


@given(entries=entries, kept=st.dictionaries(st.integers(0, 254), entries, max_size=3))
def test_a_saved_flight_file_loads_unchanged(
    tmp_path_factory: Any, entries: tuple[FlightEntry, ...], kept: dict[int, tuple[FlightEntry, ...]]
) -> None:
    path = tmp_path_factory.mktemp("flight") / "a.flight"
    contents = FlightContents(kept, entries)
    save(path, META, BYTES, contents)
    flight = load(path)
    assert flight.meta == META
    assert flight.contents == contents
    assert msgspec.msgpack.encode(flight.briefing) == BYTES
    assert os.listdir(path.parent) == ["a.flight"]


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    path = tmp_path / "a.flight"
    save(path, META, BYTES, CONTENTS)
    return path


def test_a_file_cut_at_any_byte_or_gone_on_with_is_refused(whole: Path) -> None:
    data = whole.read_bytes()
    for end in range(len(data)):
        whole.write_bytes(data[:end])
        with pytest.raises(InvalidInput) as refused:
            load(whole)
        assert refused.value.where == str(whole)
    whole.write_bytes(data + b"\0")
    with pytest.raises(InvalidInput, match="1 bytes lie behind its end"):
        load(whole)


def test_a_turned_bit_is_refused_or_means_nothing(whole: Path) -> None:
    """Deflate ignores some bits: those behind the last code, and those of a code that never occurs."""
    data = whole.read_bytes()
    harmless = 0
    for place in range(len(data)):
        turned = bytearray(data)
        turned[place] ^= 1 << place % 8
        whole.write_bytes(turned)
        try:
            flight = load(whole)
            assert (flight.contents, msgspec.msgpack.encode(flight.briefing)) == (CONTENTS, BYTES)
            harmless += 1
        except InvalidInput:
            pass
    assert harmless <= len(data) // 100


@pytest.mark.parametrize(
    ("records", "what"),
    [
        (pack(CONTENTS.entries)[:-1], "lacks 1 bytes"),
        (pack(CONTENTS.entries)[:20], "lacks 15 bytes"),
        (b"\1", "byte 0 of its records makes no sense"),
        (bytes(16), "byte 0 of its records makes no sense"),  # kind 0
    ],
)
def test_records_that_are_none_are_refused(tmp_path: Path, records: bytes, what: str) -> None:
    for packed in (PackedFlight({}, records), PackedFlight({0: records}, b"")):
        save(tmp_path / "a.flight", META, BYTES, packed)
        with pytest.raises(InvalidInput, match=what):
            load(tmp_path / "a.flight")


def test_a_briefing_that_is_none_is_refused(tmp_path: Path) -> None:
    save(tmp_path / "a.flight", META, b"\x90", CONTENTS)
    with pytest.raises(InvalidInput, match="another format"):
        load(tmp_path / "a.flight")


def test_a_file_of_another_kind_is_refused_and_one_that_cannot_be_read_is_an_os_error(tmp_path: Path) -> None:
    (tmp_path / "other").write_bytes(b"\x89MCAP0\r\n" * 10)
    with pytest.raises(InvalidInput, match="`twindctl dump` writes one"):
        load(tmp_path / "other")
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none")
    with pytest.raises(InvalidInput, match="is a folder, not a file"):
        load(tmp_path)


def test_a_flight_file_is_readable_by_its_group_only(tmp_path: Path) -> None:
    old = os.umask(0)
    try:
        save(tmp_path / "a.flight", META, BYTES, CONTENTS)
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a.flight").stat().st_mode) == 0o640


def test_a_failed_save_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(fd: int) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / "b.flight").write_bytes(b"the one before")
    monkeypatch.setattr(os, "fsync", full)
    for name in ("a.flight", "b.flight"):
        with pytest.raises(OSError, match="No space"):
            save(tmp_path / name, META, BYTES, CONTENTS)
    assert os.listdir(tmp_path) == ["b.flight"]
    assert (tmp_path / "b.flight").read_bytes() == b"the one before"


# ------------------------------------------------------------------------------- made to do harm


def forged(path: Path, head: bytes, *parts: bytes) -> Path:
    """A file whose head is right as far as its checksum goes."""
    start = file_module.MAGIC + file_module.HEAD.pack(len(head), zlib.crc32(head))
    path.write_bytes(b"".join([start, head, *parts]))
    return path


def sections(*named: tuple[str, bytes]) -> tuple[bytes, list[bytes]]:
    """A head with these sections, and they."""
    packed = [zlib.compress(data) for _, data in named]
    table = [(name, len(part), len(data)) for (name, data), part in zip(named, packed, strict=True)]
    return msgspec.msgpack.encode({"meta": {}, "sections": table}), packed


def refused(path: Path) -> str:
    with pytest.raises(InvalidInput) as error:
        load(path)
    return str(error.value)


def test_many_sections_unpack_to_no_more_than_one_may(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_module, "MOST", 3000)
    head, parts = sections(("briefing", BYTES), *[(f"kept {bus}", bytes(1000)) for bus in range(3)])
    assert "are left of 3000" in refused(forged(tmp_path / "a.flight", head, *parts))
    head, parts = sections(("briefing", BYTES), ("entries", b""), ("kept 0", bytes(1000)))
    assert "makes no sense" in refused(
        forged(tmp_path / "a.flight", head, *parts)
    )  # unpacked, then looked at


@pytest.mark.parametrize("name", ["kept 255", "kept -1", "kept 01", "other", "\x1b[2J", "entries"])
def test_a_section_that_is_none_or_there_twice_is_refused_and_its_name_shown_harmless(
    tmp_path: Path, name: str
) -> None:
    head, parts = sections(("briefing", BYTES), ("entries", b""), (name, b""))
    said = refused(forged(tmp_path / "a.flight", head, *parts))
    assert f"{name!r} is no section of it, or there twice" in said
    assert "\x1b" not in said


def test_a_head_or_a_briefing_that_is_nested_without_end_is_refused(tmp_path: Path) -> None:
    deep = b"\x91" * 100_000 + b"\xc0"
    head = b"\x82\xa4meta\x81\xa1a" + deep + b"\xa8sections\x90"
    path = forged(tmp_path / "a.flight", head)
    assert "its head has another format" in refused(path)
    with pytest.raises(InvalidInput, match="its head has another format"):
        about(path)
    briefing = BYTES.replace(b"\xaaparameters\x80", b"\xaaparameters\x81\xa1a" + deep)
    assert len(briefing) > len(deep)
    save(tmp_path / "b.flight", META, briefing, CONTENTS)
    assert "its content has another format" in refused(tmp_path / "b.flight")


def test_a_head_that_is_too_large_is_not_even_looked_at(tmp_path: Path) -> None:
    path = forged(
        tmp_path / "a.flight", msgspec.msgpack.encode({"meta": {"a": "x" * (1 << 20)}, "sections": []})
    )
    assert "at most 1048576" in refused(path)
    with pytest.raises(InvalidInput, match="at most 1048576"):
        about(path)
