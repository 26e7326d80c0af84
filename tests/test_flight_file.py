"""A flight file is whole or none: what was saved is what is loaded, and a cut or foreign one is said so."""

import os
import stat
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.briefing import Briefing, JointInfo
from twind.flight import Contents, Entry, FlightError, Kind, Packed, load, pack, save

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
CONTENTS = Contents(
    {0: (Entry(1.0, Kind.OUT, 0, b"who?"), Entry(1.1, Kind.IN, 0, b"I"))},
    (Entry(2.0, Kind.PORT, 0, b"opened /dev/ttyUSB0"), Entry(2.5, Kind.NEWS, 255, bytes(range(200)))),
)

entries = st.lists(
    st.builds(
        Entry,
        st.floats(allow_nan=False),
        st.sampled_from(Kind),
        st.integers(0, 255),
        st.binary(max_size=200),
    ),
    max_size=20,
).map(tuple)


@given(entries=entries, kept=st.dictionaries(st.integers(0, 255), entries, max_size=3))
def test_what_was_saved_is_what_is_loaded(
    tmp_path_factory: Any, entries: tuple[Entry, ...], kept: dict[int, tuple[Entry, ...]]
) -> None:
    path = tmp_path_factory.mktemp("flight") / "a.flight"
    contents = Contents(kept, entries)
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
        with pytest.raises(FlightError) as refused:
            load(whole)
        assert refused.value.path == str(whole)
        assert refused.value.remedy
    whole.write_bytes(data + b"\0")
    with pytest.raises(FlightError, match="1 bytes lie behind its end"):
        load(whole)


def test_a_turned_bit_is_refused_or_means_nothing(whole: Path) -> None:
    """It means nothing in the last byte of a packed section, of which not every bit is used."""
    data, harmless = whole.read_bytes(), 0
    for place in range(len(data)):
        turned = bytearray(data)
        turned[place] ^= 1 << place % 8
        whole.write_bytes(turned)
        try:
            assert load(whole).contents == CONTENTS
            harmless += 1
        except FlightError:
            pass
    assert harmless <= 3


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
    for packed in (Packed({}, records), Packed({0: records}, b"")):
        save(tmp_path / "a.flight", META, BYTES, packed)
        with pytest.raises(FlightError, match=what):
            load(tmp_path / "a.flight")


def test_a_briefing_that_is_none_is_refused(tmp_path: Path) -> None:
    save(tmp_path / "a.flight", META, b"\x90", CONTENTS)
    with pytest.raises(FlightError, match="not ours"):
        load(tmp_path / "a.flight")


def test_a_file_of_another_kind_is_refused_and_one_that_cannot_be_read_is_an_os_error(tmp_path: Path) -> None:
    (tmp_path / "other").write_bytes(b"\x89MCAP0\r\n" * 10)
    with pytest.raises(FlightError, match="`twindctl dump` writes one"):
        load(tmp_path / "other")
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none")
    with pytest.raises(IsADirectoryError):
        load(tmp_path)


def test_the_group_may_read_it_and_nobody_else(tmp_path: Path) -> None:
    old = os.umask(0)
    try:
        save(tmp_path / "a.flight", META, BYTES, CONTENTS)
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a.flight").stat().st_mode) == 0o640


def test_what_could_not_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(fd: int) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / "b.flight").write_bytes(b"the one before")
    monkeypatch.setattr(os, "fsync", full)
    for name in ("a.flight", "b.flight"):
        with pytest.raises(OSError, match="No space"):
            save(tmp_path / name, META, BYTES, CONTENTS)
    assert os.listdir(tmp_path) == ["b.flight"]
    assert (tmp_path / "b.flight").read_bytes() == b"the one before"


def test_a_link_in_the_place_of_its_draft_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "precious").write_bytes(b"precious")
    (tmp_path / ".a.flight.tmp").symlink_to(tmp_path / "precious")
    with pytest.raises(OSError, match="symbolic"):
        save(tmp_path / "a.flight", META, BYTES, CONTENTS)
    assert (tmp_path / "precious").read_bytes() == b"precious"
