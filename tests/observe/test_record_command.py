"""Options and run of `twindctl record`: sizes, folders, a clock that is set."""

import argparse
import json
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.sample_recordings import CLOCKS, SESSION, SteppedWriter
from twind.client.clock_pair import ClockPair
from twind.command_line.progress import ProgressLine
from twind.command_line.verb import UsageError
from twind.observe import record
from twind.observe.recording.recording_topics import NOTES
from twind.observe.writing import recorder as record_run
from twind.observe.writing.record_schemas import json_schemas
from twind.observe.writing.record_writer import OpenEpisode, RecordCounts
from twind.observe.writing.recorder import Recorder, line, summary

SIZES = [("0", 0), ("512", 512), ("1k", 1024), ("500M", 500 << 20), ("1.5GiB", 3 << 29), ("2T", 2 << 40)]


@pytest.mark.parametrize(("text", "bytes_"), SIZES)
def test_a_size_with_a_unit_is_parsed(text: str, bytes_: int) -> None:
    assert record.size(text) == bytes_


@pytest.mark.parametrize("text", ["", "G", "ten", "-1M", "1e999G", "nan"])
def test_an_invalid_size_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError):
        record.size(text)


def options(**given: Any) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--socket")
    record.add_arguments(parser)
    return argparse.Namespace(**(vars(parser.parse_args([])) | given))


def test_a_file_that_is_there_or_no_time_at_all_is_a_usage_error(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.touch()
    with pytest.raises(UsageError, match="is never written over"):
        record.run(options(out=path))
    with pytest.raises(UsageError, match="must be above 0"):
        record.run(options(seconds=0.0))
    with pytest.raises(UsageError, match="name another folder with --out"):
        record.run(options(out=path / "folder"))


@pytest.mark.parametrize("writable", [True, False])
def test_the_usual_folder_is_the_daemons_where_we_may_write_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writable: bool
) -> None:
    class Asked:
        def __enter__(self) -> "Asked":
            return self

        def __exit__(self, *_: object) -> None: ...

        def call(self, _method: str) -> dict[str, Any]:
            return {"parameters": {"state_dir": str(tmp_path / "state" if writable else "/proc/self")}}

    (tmp_path / "state").mkdir()
    monkeypatch.setattr(record, "observer", lambda _: Asked())
    monkeypatch.setattr(record.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(record.os, "access", lambda *_: writable)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "own"))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    expected = tmp_path / "state" / "recordings" if writable else tmp_path / "own" / "twind" / "recordings"
    assert record.usual_folder(options()) == expected


def test_a_clock_that_is_set_is_noted_once_with_both_and_times_go_on_as_they_were(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = SteppedWriter(tmp_path)
    course = Recorder(options(), rig.writer, threading.Event())
    listening: Any = SimpleNamespace(session=SESSION)
    jump = 3_600_000_000_000
    for _ in range(5):
        rig.run(1.0)
        now = ClockPair(rig.time, CLOCKS.wall(rig.time) + (jump if rig.time > 102.5 else 0))
        monkeypatch.setattr(record_run, "clocks", lambda now=now: now)
        course.check_clock(listening)
    (found,) = rig.finish()
    assert found.duration == pytest.approx(4.99) and found.start_ns == CLOCKS.wall(100.01)
    (note,) = [each.what for each in found.notes]
    assert note["kind"] == "clock_step" and note["wall_ns"] - note["expected_ns"] == jump
    assert note["monotonic"] == 103.0


def test_a_clock_that_was_set_is_no_news_to_the_file_that_begins_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jump = 3_600_000_000_000

    def clocks() -> ClockPair:
        return ClockPair(rig.time, CLOCKS.wall(rig.time) + (jump if rig.time > 102.5 else 0))

    rig = SteppedWriter(tmp_path, {"longest": 5.0}, clocks=clocks)
    monkeypatch.setattr(record_run, "clocks", clocks)
    course = Recorder(options(), rig.writer, threading.Event())
    listening: Any = SimpleNamespace(session=SESSION)
    for _ in range(8):
        rig.run(1.0)
        course.check_clock(listening)
    first, second = rig.finish()
    assert [each.what["kind"] for each in first.notes] == ["clock_step"] and not second.notes
    assert second.start_ns > first.start_ns + jump


def test_an_episode_the_daemon_cannot_receive_is_recorded_in_the_schema_format(
    tmp_path: Path,
) -> None:
    rig = SteppedWriter(tmp_path)
    rig.writer.start()
    course = Recorder(options(task="pick", socket=str(tmp_path)), rig.writer, threading.Event())
    listening: Any = SimpleNamespace(session=SESSION)
    course.send_mark(listening, "begin")
    course.send_mark(listening, "end")
    (found,) = rig.finish()
    assert [each.task for each in found.episodes] == ["pick"]
    schema = json.loads(json_schemas()[NOTES])["properties"]
    for each in found.notes:
        assert each.what.keys() <= schema.keys()
        assert each.what["annotation"].keys() <= schema["annotation"]["properties"].keys()


def test_every_file_is_named_as_soon_as_it_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = SteppedWriter(tmp_path, {"longest": 2.0})
    course = Recorder(options(), rig.writer, threading.Event())
    with ProgressLine(options(), "record") as progress:
        for _ in range(3):
            course.name_files(progress, "two")
            rig.run(1.5)
        course.name_files(progress, "two")
    assert len(rig.finish()) == 3
    assert capsys.readouterr().err.splitlines() == [
        f"recording two into {each}" for each in rig.writer.tally.files
    ]


def test_the_record_summary_names_losses() -> None:
    tally = RecordCounts(path=Path("/x/a.mcap"), files=(Path("/x/a.mcap"),), messages=9, bytes=3 << 20)
    assert line(tally, 301.4) == "301 messages/s  3.0 MiB  a.mcap"
    busy = RecordCounts(path=Path("/x/a.mcap"), dropped=3, missed=2, episode=OpenEpisode("pick", 0))
    assert line(busy, 0.0) == "0 messages/s  0.0 MiB  5 DROPPED  episode pick  a.mcap"
    assert summary(tally, 2.0) == "/x/a.mcap\n2.0 s, 9 messages; nothing dropped"
    lost = RecordCounts(files=(Path("/x/a.mcap"),), messages=9, dropped=3, missed=2, episodes=2, removed=1)
    assert summary(lost, 2.0).endswith(
        "2.0 s, 9 messages, 2 episodes; dropped: 2 by the daemon, 3 here (the disk was too slow); "
        "1 old recordings made room"
    )
    assert summary(RecordCounts(), 1.0) == "nothing was recorded"
