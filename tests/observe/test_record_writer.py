"""Writer of recordings: files that end in time, bounded disks, counted losses."""

import errno
import fcntl
import os
import threading
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from tests.support.sample_recordings import (
    CLOCKS,
    JOINTS,
    SESSION,
    FullDisk,
    SteppedWriter,
    event,
    mark,
    state,
    trajectories,
)
from twind.client.clock_pair import ClockPair
from twind.command_line.verb import Rejected
from twind.observe.recording import open_recording
from twind.observe.recover import recover
from twind.observe.writing import record_writer
from twind.observe.writing.record_encoder import RecordEncoder
from twind.observe.writing.record_file import BufferedFile, RecordFile
from twind.observe.writing.record_folder import DiskQuota, fresh, make_room
from twind.observe.writing.record_writer import RecordWriter

WIDE = DiskQuota(keep=1 << 40, free=0, file=1 << 40)


def metadata(path: Path) -> list[tuple[str, dict[str, str]]]:
    """As the library's own reader finds them, by the index."""
    with path.open("rb") as file:
        return [(each.name, each.metadata) for each in make_reader(file).iter_metadata()]


@pytest.fixture
def rig(tmp_path: Path) -> SteppedWriter:
    return SteppedWriter(tmp_path)


def test_a_message_is_in_the_file_within_half_a_second(rig: SteppedWriter) -> None:
    worst = 0.0
    for _ in range(300):
        rig.run(0.01)
        path = rig.writer.tally.path
        assert path is not None
        found = open_recording(path) if rig.time > 100.6 else None
        if found is not None:
            worst = max(worst, rig.time - 100.0 - (found.start_ns - CLOCKS.wall_ns) / 1e9 - found.time[-1])
    assert 0.4 < worst < 0.6  # by that a kill at any moment loses less than a second


def test_a_session_is_one_file_with_its_description(rig: SteppedWriter) -> None:
    rig.run(1.0)
    rig.writer.end()
    rig.writer.step()
    (path,) = rig.writer.tally.files
    assert path.name == "twind-20261118T110640Z-two.mcap"
    found = open_recording(path)
    assert found.joints == JOINTS and found.time.size == 100 and not found.damage
    assert found.robot == {"name": "two"} and found.mjcf == "<mujoco/>" and found.calibration is None
    assert metadata(path) == [
        ("twind", dict(SESSION.about)),
        (
            "end",
            {"reason": "the daemon is gone", "messages": "102", "dropped": "0", "dropped_by_daemon": "0"},
        ),
    ]


def test_between_two_daemons_nothing_is_written_and_each_has_its_own_file(
    rig: SteppedWriter,
) -> None:
    rig.run(0.5)
    rig.writer.end()
    rig.take(state(200.0))
    rig.writer.begin(SESSION)
    rig.run(0.5)
    assert [found.time.size for found in rig.finish()] == [50, 50]


def test_a_file_ends_at_its_hour(tmp_path: Path) -> None:
    rig = SteppedWriter(tmp_path, {"longest": 60.0})
    rig.run(100.0, rate=2.0)
    rows = [found.time.size for found in rig.finish()]
    ends = [dict(metadata(path))["end"]["reason"] for path in rig.writer.tally.files]
    assert rig.writer.quota.longest == 60.0 and DiskQuota(1, 1, 1).longest == 3600.0
    assert ends == ["an hour", "stopped"]
    assert sum(rows) == 200 and 119 <= rows[0] <= 121


def test_the_oldest_own_recordings_are_removed_and_no_other_files(tmp_path: Path) -> None:
    others = [tmp_path / "precious.mcap", tmp_path / "twind-20200101T000000Z-two.mcap.bak"]
    for path in others:
        path.write_bytes(bytes(100_000))
    old = tmp_path / "twind-20200101T000000Z-two.mcap"
    old.write_bytes(bytes(100_000))
    rig = SteppedWriter(tmp_path, {"keep": 60_000})
    rig.run(60.0)
    rig.writer.close()
    tally = rig.writer.tally
    assert not old.exists() and all(path.exists() for path in others)
    left = [path for path in tally.files if path.exists()]
    assert (
        tally.files[-1] in left and left == list(tally.files[-len(left) :]) and len(left) < len(tally.files)
    )
    assert tally.removed == 1 + len(tally.files) - len(left)
    assert sum(path.stat().st_size for path in left) <= 60_000
    assert all(not open_recording(path).damage for path in left)


def test_a_recording_being_written_is_not_removed(tmp_path: Path) -> None:
    path = fresh(tmp_path, CLOCKS.wall_ns, "h24")
    file = RecordFile(path, {}, {}, CLOCKS.wall_ns)
    assert make_room(tmp_path, 0) == [] and path.exists()
    file.finish()
    assert make_room(tmp_path, 0) == [path] and not path.exists()


def test_names_are_of_the_robot_and_never_taken_twice(tmp_path: Path) -> None:
    first = fresh(tmp_path, CLOCKS.wall_ns, "../h 24/é")
    first.touch()
    second = fresh(tmp_path, CLOCKS.wall_ns, "../h 24/é")
    assert first.parent == tmp_path and first.name == "twind-20261118T110640Z-h-24-é.mcap"
    assert second.name == "twind-20261118T110640Z-h-24-é.2.mcap"
    assert make_room(tmp_path, -1) == [first]


def test_the_floor_of_free_space_stops_it_with_a_reason_and_a_whole_file(rig: SteppedWriter) -> None:
    rig.run(1.0)
    rig.writer.quota = DiskQuota(keep=1 << 40, free=1 << 60, file=1 << 40)
    rig.run(1.0)
    assert "MiB are free, 1099511627776 MiB are to stay so; make room" in rig.writer.stopped
    (path,) = rig.writer.tally.files
    found = open_recording(path)
    assert not found.damage and 100 <= found.time.size < 200


@pytest.mark.parametrize("room", [300, 3_000, 9_000, 9_100, 9_200, 20_000])
def test_a_full_disk_stops_it_with_a_reason_and_the_file_is_readable(tmp_path: Path, room: int) -> None:
    def on(path: Path, about: Any, attachments: Any, time_ns: int) -> RecordFile:
        return RecordFile(path, about, attachments, time_ns, disk=FullDisk(path, room))

    rig = SteppedWriter(tmp_path, open_file=on)
    rig.run(20.0)
    rig.writer.close()
    assert rig.writer.stopped.endswith("No space left on device; free space on that disk")
    (path,) = tmp_path.iterdir()
    if room < 9_000:
        with pytest.raises(Rejected, match="no message is in it"):
            open_recording(path)  # a file without a first half second
    else:
        with path.open("rb") as file:
            rows = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
        assert rows.count("/hw/joint_states") == open_recording(path).time.size >= 49
        tally = rig.writer.tally
        assert tally.messages == len(rows) and tally.dropped > 0
    assert path.stat().st_size <= room


def test_a_slow_disk_loses_counted_messages_without_delaying_the_caller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stuck(BufferedFile):
        def pour(self, data: memoryview) -> None:
            moving.wait(10.0)
            super().pour(data)

    def on(path: Path, about: Any, attachments: Any, time_ns: int) -> RecordFile:
        return RecordFile(path, about, attachments, time_ns, disk=Stuck(path))

    monkeypatch.setattr(record_writer, "ROOM", 20_000)
    moving = threading.Event()
    writer = RecordWriter(tmp_path, WIDE, lambda: 100.0, open_file=on)
    scribe = RecordEncoder(JOINTS, CLOCKS)
    writer.begin(SESSION)
    writer.start()
    lines = [line for place in range(1000) for line in scribe.take(state(100.0 + place / 100))]
    taken = [writer.put(line) for line in lines]  # returns at once, though nothing is written
    rare = [writer.put(line) for line in scribe.take(event(111.0, "ESTOP"))]
    assert not all(taken) and rare == [True]
    assert sum(len(line.data) for line, yes in zip(lines, taken, strict=True) if yes) <= 2 * 20_000
    moving.set()
    assert writer.close()
    found = open_recording(writer.tally.files[0])
    lost = taken.count(False)
    assert writer.tally.dropped == lost and found.time.size + lost >= 1000
    assert [note.what["count"] for note in found.notes] == [lost]
    assert found.events[0].what["code"] == "ESTOP"
    assert dict(metadata(writer.tally.files[0]))["end"]["dropped"] == str(lost)


def test_messages_dropped_by_the_daemon_are_noted_in_the_file(rig: SteppedWriter) -> None:
    rig.run(0.3)
    rig.writer.missed(7)
    rig.run(0.5)
    (found,) = rig.finish()
    assert [note.what for note in found.notes] == [{"kind": "dropped", "count": 7}]
    assert dict(metadata(rig.writer.tally.files[0]))["end"]["dropped_by_daemon"] == "7"


def test_episodes_stand_in_the_file_with_task_times_and_success(rig: SteppedWriter) -> None:
    rig.take(mark(99.0, "end", "before", success=True))
    rig.take(mark(101.0, "begin"), mark(103.0, "end", success=True))
    rig.take(mark(104.0, "begin", "place"), mark(105.0, "begin", "pour"), mark(106.0, "end", success=False))
    rig.take(mark(107.0, "begin", "wipe"))
    rig.run(1.0)
    (recorded,) = rig.finish()
    (path,) = rig.writer.tally.files
    ns = {"": "", **{time: str(CLOCKS.wall(float(time))) for time in range(99, 108)}}
    kept = [each for name, each in metadata(path) if name == "episode"]
    rows = [("before", "true", "", 99), ("pick", "true", 101, 103), ("place", "", 104, 105)]
    rows += [("pour", "false", 105, 106), ("wipe", "", 107, "")]
    assert kept == [
        {"task": task, "success": success, "begin": ns[begin], "end": ns[end]}
        for task, success, begin, end in rows
    ]
    found = recorded.episodes
    assert [each.task for each in found] == ["before", "pick", "place", "pour", "wipe"]
    assert [each.success for each in found] == [True, True, None, False, None]
    assert (found[1].begin, found[1].end) == (2.0, 4.0)
    assert rig.writer.tally.episodes == 4


def test_an_episode_may_have_a_file_of_its_own_and_nothing_else_does(tmp_path: Path) -> None:
    rig = SteppedWriter(tmp_path, per_episode=True)
    rig.run(1.0)
    for task in ("pick", "place"):
        rig.take(mark(rig.time, "begin", task))
        rig.run(1.0)
        rig.take(mark(rig.time, "end", task, success=True))
        rig.run(1.0)
    recorded = rig.finish()
    names = [found.path.name.split("Z-")[1] for found in recorded]
    assert names == ["two-pick.mcap", "two-place.mcap"] and len(list(tmp_path.iterdir())) == 2
    for found in recorded:
        assert found.time.size == 100 and [each.success for each in found.episodes] == [True]


@pytest.mark.parametrize("why", ["its size", "another daemon"])
def test_an_episode_goes_on_in_the_next_file_where_its_own_ended_before_it(tmp_path: Path, why: str) -> None:
    rig = SteppedWriter(tmp_path, {"file": 20_000} if why == "its size" else {}, per_episode=True)
    rig.run(1.0)
    rig.take(mark(rig.time, "begin"))
    rig.run(2.0)
    if why == "another daemon":
        rig.writer.end()
        rig.writer.begin(SESSION)
    rig.run(2.0)
    rig.take(mark(rig.time, "end", success=True))
    rig.run(1.0)
    recorded = rig.finish()
    files = rig.writer.tally.files
    assert len(files) > 1 and sum(found.time.size for found in recorded) == 400
    assert all(path.name.split("Z-")[1].startswith("two-pick.") for path in files)
    ends = [dict(metadata(path))["episode"] for path in files]
    assert [each["success"] for each in ends] == [""] * (len(files) - 1) + ["true"]
    assert {each["begin"] for each in ends} == {ends[0]["begin"]} and ends[0]["end"] == ""
    assert rig.writer.tally.episodes == 1 and rig.writer.tally.episode is None


def test_an_episode_is_over_though_its_end_is_in_no_file(tmp_path: Path) -> None:
    rig = SteppedWriter(tmp_path, per_episode=True)
    rig.take(mark(100.0, "begin"))
    rig.writer.end()
    rig.take(mark(101.0, "end"))
    assert rig.writer.tally.episode is None
    rig.writer.begin(SESSION)
    rig.run(1.0)
    assert len(rig.finish()) == 1


def test_the_next_file_has_the_right_time_after_the_clock_was_set(tmp_path: Path) -> None:
    years = 5 * 365 * 86_400 * 10**9

    def clocks() -> ClockPair:
        at = rig.time
        return ClockPair(at, CLOCKS.wall(at) + (years if at > 130.0 else 10_000_000))

    rig = SteppedWriter(tmp_path, {"longest": 60.0}, clocks=clocks)
    rig.run(100.0, rate=2.0)
    path = {"joint_names": ["hip"], "points": [{"positions": [1.0], "time_from_start": 1.0}], "start_in": 2.0}
    accepted = {"topic": "trajectories", "time": rig.time, "dropped": 0}
    rig.take(accepted | {"accepted": {"id": "a", "holder": "me", "trajectory": path}})
    rig.writer.missed(1)
    rig.run(1.0)
    first, second = rig.finish()
    files = rig.writer.tally.files
    assert first.start_ns == CLOCKS.wall(100.5)
    assert second.start_ns == CLOCKS.wall(100.5 + first.time.size / 2) + years
    assert "-2026" in files[0].name and "-2031" in files[1].name
    assert int(second.meta["wall_ns"]) - CLOCKS.wall(float(second.meta["monotonic"])) == years
    assert second.notes[0].time < 60.0 and trajectories(files[1])[0]["start_in"] == 2.0
    with files[1].open("rb") as stream:
        read = make_reader(stream, decoder_factories=[DecoderFactory()])
        states = [(log, said) for _, _, log, said in read.iter_decoded_messages(["/hw/joint_states"])]
    assert len(states) == second.time.size
    assert all(
        each.log_time == said.header.stamp.sec * 10**9 + said.header.stamp.nanosec for each, said in states
    )


def test_a_recording_of_a_wrong_clock_is_not_the_oldest_for_its_name(tmp_path: Path) -> None:
    files = [tmp_path / f"twind-{when}T000000Z-two.mcap" for when in (20200101, 20210101, 19700101)]
    for hours, path in enumerate(files):
        path.write_bytes(bytes(9))
        os.utime(path, (1e9 + hours * 3600, 1e9 + hours * 3600))
    assert make_room(tmp_path, 18) == [files[0]]
    made_now = tmp_path / "twind-19700101T000001Z-two.mcap"
    made_now.write_bytes(bytes(9))
    os.utime(made_now, (1.0, 1.0))  # of the same clock
    assert make_room(tmp_path, 9, newest=[made_now]) == files[1:]


def test_recovered_or_renamed_recordings_are_kept(tmp_path: Path) -> None:
    stem = "twind-20261122T161500Z-h24"
    kept = [f"{stem}-recovered.mcap", f"{stem}.2-recovered.mcap", f"{stem}.good.mcap", f"keep-{stem}.mcap"]
    for name in [*kept, f"{stem}.mcap", f"{stem}.12.mcap"]:
        (tmp_path / name).touch()
    fresh(tmp_path, CLOCKS.wall_ns, "h24-recovered").touch()  # a robot, or a task, may have that name
    fresh(tmp_path, CLOCKS.wall_ns, "é" * 100).touch()
    assert len(make_room(tmp_path, -1)) == 4
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(kept)


def test_a_named_file_is_never_written_over(tmp_path: Path) -> None:
    place = tmp_path / "run.mcap"
    rig = SteppedWriter(place)
    rig.run(0.5)
    rig.writer.begin(SESSION)
    rig.run(0.5)
    rig.writer.close()
    assert rig.writer.tally.files == (place, tmp_path / "run.2.mcap")
    assert recover(place).out is None


def test_without_file_locks_recording_works_and_keeps_its_own_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(_fd: int, _how: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", none)
    rig = SteppedWriter(tmp_path, {"keep": 8})
    old = tmp_path / "twind-20200101T000000Z-two.mcap"
    old.write_bytes(bytes(9))
    rig.run(0.3)
    (found,) = rig.finish()
    assert not old.exists() and found.time.size == 30


def test_a_message_after_the_end_starts_no_file(rig: SteppedWriter) -> None:
    rig.run(0.3)
    rig.writer.close()
    rig.run(0.3)
    rig.writer.close()
    assert len(rig.writer.tally.files) == 1


@pytest.mark.parametrize("place", ["", "run.mcap"])
def test_a_name_that_another_recorder_takes_in_the_same_moment_ends_no_recording(
    tmp_path: Path, place: str
) -> None:
    taken: list[Path] = []

    def open_after_another(path: Path, *given: Any) -> RecordFile:
        if not taken:
            taken.append(path)
            path.touch()
        return RecordFile(path, *given)

    writer = RecordWriter(tmp_path / place, WIDE, lambda: 100.0, open_file=open_after_another)
    writer.begin(SESSION)
    for line in RecordEncoder(JOINTS, CLOCKS).take(state(100.0)):
        writer.put(line)
    writer.close()
    assert writer.stopped == "" and writer.tally.messages > 0
    (written,) = writer.tally.files
    assert written not in taken and open_recording(written).joints == JOINTS
