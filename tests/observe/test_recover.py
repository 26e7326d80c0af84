"""Cut files become whole ones."""

import argparse
import json
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from tests.support.sample_recordings import FullDisk, SteppedWriter, write
from twind.command_line.verb import Rejected
from twind.observe import recover as verb
from twind.observe.recording import open_recording
from twind.observe.recording.mcap_record_scanner import McapRecordScanner
from twind.observe.recover import recover
from twind.observe.writing.record_file import RecordFile


def count(path: Path) -> int:
    return sum(isinstance(each, Message) for each in McapRecordScanner(path).contents())


def options(path: Path, out: Path | None = None) -> argparse.Namespace:
    return argparse.Namespace(file=path, out=out, json=True)


def test_a_cut_file_becomes_a_whole_one_with_all_that_was_whole_in_it(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.mcap", 1.0)
    data = whole.read_bytes()
    for place, end in enumerate(range(400, len(data), 211)):
        cut = tmp_path / f"cut{place}.mcap"
        cut.write_bytes(data[:end])
        kept = count(cut)
        if not kept:
            with pytest.raises(Rejected, match="no message in it is whole"):
                recover(cut)
            assert len(list(tmp_path.glob(f"cut{place}*"))) == 1
            continue
        found = recover(cut)
        assert found.out == tmp_path / f"cut{place}-recovered.mcap" and found.messages == kept
        assert found.lost < end and found.why and cut.read_bytes() == data[:end]
        with found.out.open("rb") as stream:
            reader = make_reader(stream)
            assert len(list(reader.iter_messages())) == kept
            names = [each.name for each in reader.iter_metadata()]
            assert names == ["twind", "recovered"]
            assert [each.name for each in reader.iter_attachments()] == ["robot.json", "model.mjcf"]
        with AnyReader([found.out]) as bag:
            assert sum(each.msgcount for each in bag.topics.values()) == kept
        assert recover(found.out).out is None
        found.out.unlink()


def test_a_whole_file_is_left_alone(tmp_path: Path) -> None:
    path = write(tmp_path / "b.mcap")
    before = path.read_bytes()
    found = recover(path)
    assert found.out is None and found.messages == count(path) and str(found).startswith("whole already: 202")
    assert list(tmp_path.iterdir()) == [path] and path.read_bytes() == before
    assert recover(path, tmp_path / "copy.mcap").out == tmp_path / "copy.mcap"


def test_nothing_is_ever_written_over(tmp_path: Path) -> None:
    path = write(tmp_path / "c.mcap")
    path.write_bytes(path.read_bytes()[:-100])
    for taken in (path, write(tmp_path / "c-recovered.mcap")):
        before = taken.read_bytes()
        with pytest.raises(Rejected, match="is there already; name another file with --out"):
            recover(path, taken if taken == path else None)
        assert taken.read_bytes() == before


def test_a_recovery_reports_kept_messages_and_lost_bytes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "d.mcap")
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b"zstd", data.index(b"zstd") + 4) + 100])  # in the second chunk
    assert verb.run(options(path)) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["messages"] == count(tmp_path / "d-recovered.mcap") and said["lost_bytes"] > 0
    assert said["why"]


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Rejected, match=r"gone\.mcap: No such file"):
        recover(tmp_path / "gone.mcap")


def test_a_recording_that_a_full_disk_ended_is_not_taken_for_a_whole_one(tmp_path: Path) -> None:
    def on(path: Path, about: Any, attachments: Any, time_ns: int) -> RecordFile:
        return RecordFile(path, about, attachments, time_ns, disk=FullDisk(path, 20_000))

    rig = SteppedWriter(tmp_path, open_file=on)
    rig.run(20.0)
    tally = rig.writer.tally
    (path,) = tally.files
    assert tally.dropped > 0
    assert "it has no index: a full disk may have ended it" in open_recording(path).damage
    found = recover(path)
    assert found.out == path.with_name(f"{path.stem}-recovered.mcap") and found.messages == tally.messages
    assert "no index" in found.why and not open_recording(found.out).damage


def test_a_malformed_mcap_file_is_refused(tmp_path: Path) -> None:
    whole = McapRecordScanner(write(tmp_path / "f.mcap", 0.5))
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(library=whole.library)
        channel = writer.register_channel("/x", "json", 0)
        writer.add_message(channel, 1, b"\xff\xfe", 1)
        writer.finish()
    with pytest.raises(Rejected, match=r"it is not as MCAP files are .UnicodeDecodeError"):
        recover(path, tmp_path / "out.mcap", ros=True)
    data = bytearray(path.read_bytes())
    at = data.index(b"\xff\xfe") - 22  # the number of the message's channel
    data[at : at + 2] = b"\x09\x00"
    path.write_bytes(data)
    with pytest.raises(Rejected, match=r"it is not as MCAP files are .KeyError: 9"):
        recover(path, tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()
