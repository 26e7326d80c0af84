"""One reader of every kind of recording: ours, others' and a flight recorder's."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.records import Message
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from tests.support.doc_pages_text import ROOT
from tests.support.replay_rig import flight, recording
from tests.support.sample_recordings import (
    CLOCKS,
    JOINTS,
    SteppedWriter,
    event,
    mark,
    state,
    status,
    trajectories,
)
from twind.command_line.verb import Rejected
from twind.flight import EntryKind, FlightContents, FlightEntry, LoadedFlight, save
from twind.link import Tick, decode_news
from twind.link import encode as encode_news
from twind.observe import replay
from twind.observe.export import export
from twind.observe.recording import open_recording
from twind.observe.recording.mcap_record_scanner import McapRecordScanner
from twind.observe.recording.recording_columns import RecordedMessage, RobotRecording, marked
from twind.observe.recording.recording_topics import WIRE
from twind.observe.writing.record_schemas import json_schemas
from twind.ros import JOINT_STATE, definition_text, encode, stamp

START = 1_700_000_000_000_000_000


def record(folder: Path, *answers: dict[str, Any]) -> RobotRecording:
    rig = SteppedWriter(folder)
    rig.take(*answers)
    (found,) = rig.finish()
    return found


def foreign(path: Path, *rows: tuple[str, float, dict[str, Any]]) -> Path:
    """A recording as other programs make it: (topic, time in s, JointState)."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition_text(JOINT_STATE).encode())
        channels: dict[str, int] = {}
        for topic, time, message in rows:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            at = START + round(time * 1e9)
            data = encode(JOINT_STATE, {"header": {"stamp": stamp(at)}, **message})
            writer.add_message(channels[topic], at, data, at)
        writer.finish()
    return path


def test_a_stored_recording_of_the_first_release_of_the_format_reads_as_it_was_written() -> None:
    """Positions are sines of the time, see tests/data/README.md."""
    found = open_recording(ROOT / "tests" / "data" / "recordings" / "two.mcap")
    assert (found.joints, found.damage, found.robot) == (("hip", "knee"), "", {"name": "two"})
    assert found.mjcf and found.start_ns == 1795000000000000000
    times = 100.0 + np.arange(100) / 100.0
    np.testing.assert_allclose(found.time, times - 100.0, atol=1e-9)
    np.testing.assert_array_equal(found.measured, np.column_stack([np.sin(times), np.sin(times + 1)]))
    np.testing.assert_array_equal(found.goal, np.full((100, 2), 0.1))


def test_rows_of_one_moment_are_one_row_and_what_is_not_known_is_nan(tmp_path: Path) -> None:
    found = record(tmp_path, state(100.0), state(100.5, goal=0.25), state(101.0, simulated=1.5))
    assert found.joints == JOINTS and found.start_ns == CLOCKS.wall_ns
    assert found.time.tolist() == [0.0, 0.5, 1.0] and found.duration == 1.0
    assert np.isnan(found.goal[[0, 2]]).all() and (found.goal[1] == 0.25).all()
    assert np.isnan(found.simulated[:2]).all() and (found.simulated[2] == 1.5).all()
    assert found.measured[:, 0].tolist() == [np.sin(100.0), np.sin(100.5), np.sin(101.0)]
    assert (found.velocity == 0.5).all() and np.isnan(found.effort).all()
    assert found.slow is not None and found.slow.time.tolist() == [0.0, 0.5, 1.0]
    assert (found.slow.temperature == 40.0).all() and (found.slow.torque == 1.0).all()
    assert (found.slow.age == 0.001).all()


def test_imu_readings_are_rows_and_missing_ones_are_nan(tmp_path: Path) -> None:
    felt = {"gyro": [0.1, 0.2, 0.3], "acceleration": [1.0, 2.0, 9.0], "quaternion": [0.5, -0.5, 0.5, -0.5]}
    imus = [felt | {"age_ms": age} for age in (2, 12, 2)]
    rows = [state(100.0 + tick / 100) | {"imu": imu} for tick, imu in enumerate(imus)]
    found = record(tmp_path, *rows).imu
    assert found is not None
    assert found.gyro.tolist()[::2] == [felt["gyro"]] * 2 and np.isnan(found.gyro[1]).all()
    assert found.acceleration[2].tolist() == felt["acceleration"]
    assert found.quaternion[2].tolist() == felt["quaternion"]
    (tmp_path / "without").mkdir()
    assert record(tmp_path / "without", state(100.0)).imu is None
    (file,) = tmp_path.glob("*.mcap")
    with AnyReader([file]) as bag:
        (topic,) = [each for each in bag.connections if each.topic == "/imu"]
        *_, (_, _, data) = bag.messages([topic])
        message: Any = bag.deserialize(data, topic.msgtype)
    assert topic.msgtype == "sensor_msgs/msg/Imu" and message.header.frame_id == "base"
    assert (message.orientation.w, message.linear_acceleration.z) == (0.5, 9.0)


def test_the_target_is_the_robot_in_live_and_the_simulation_otherwise(tmp_path: Path) -> None:
    rows = [status(99.0, "mirror"), state(100.0, simulated=5.0), status(101.0, "live")]
    found = record(tmp_path, *rows, state(102.0, simulated=5.0))
    assert found.live.tolist() == [False, True]
    assert found.target.tolist() == [[5.0, 5.0], found.measured[1].tolist()]


def test_latency_is_columns_by_hop_with_the_last_histogram(tmp_path: Path) -> None:
    def latencies(time: float, now: float | None, histogram: Any) -> dict[str, Any]:
        hops = [{"hop": "total", "now_ms": now, "violations": 2, "histogram": histogram}]
        return {"topic": "latency", "time": time, "latency": hops}

    buckets = [{"upper_ms": 1.0, "count": 3}, {"upper_ms": None, "count": 0}]
    found = record(tmp_path, latencies(100.0, 1.5, buckets), latencies(100.1, None, None)).latency["total"]
    assert found.time.tolist() == [0.0, 0.1] and found.columns["violations"].tolist() == [2.0, 2.0]
    assert found.columns["now_ms"][0] == 1.5 and np.isnan(found.columns["now_ms"][1])
    assert np.isnan(found.columns["p99_ms"]).all() and list(found.histogram) == buckets


def test_episodes_follow_the_marks_of_any_client() -> None:
    def events(*answers: dict[str, Any]) -> list[RecordedMessage]:
        return [RecordedMessage(answer["time"], answer["event"]) for answer in answers]

    begun = mark(3.0, "begin", "b"), mark(4.0, "begin", "c")
    rows = events(mark(1.0, "end", "a", True), event(2.0, "ESTOP"), *begun)
    found = marked(rows)
    assert [(each.task, each.success) for each in found] == [("a", True), ("b", None), ("c", None)]
    assert np.isnan(found[0].begin) and (found[1].begin, found[1].end) == (3.0, 4.0)
    assert np.isnan(found[2].end) and marked([]) == ()


def test_a_recording_of_others_is_read_by_names_in_whatever_order_they_come(tmp_path: Path) -> None:
    one = {"name": ["a", "b"], "position": [1.0, 2.0], "velocity": [0.1, 0.2]}
    two = {"name": ["c", "b"], "position": [3.0, 4.0]}
    path = foreign(tmp_path / "a.mcap", ("/joint_states", 0.0, one), ("/joint_states", 1.0, two))
    found = open_recording(path)
    assert found.joints == ("a", "b", "c") and found.start_ns == START
    np.testing.assert_array_equal(found.measured, [[1.0, 2.0, np.nan], [np.nan, 4.0, 3.0]])
    np.testing.assert_array_equal(found.velocity, [[0.1, 0.2, np.nan], [np.nan] * 3])
    assert np.isnan(found.goal).all() and found.live.all() and found.robot is None and not found.events
    np.testing.assert_array_equal(found.target, found.measured)


def test_the_usual_joint_state_topic_is_preferred_among_foreign_topics(tmp_path: Path) -> None:
    rows = [("/wrist/joint_states", 0.0, {"name": ["w"], "position": [9.0]})]
    rows += [("/joint_states", 0.1, {"name": ["a"], "position": [1.0]})]
    assert open_recording(foreign(tmp_path / "a.mcap", *rows)).joints == ("a",)
    assert open_recording(foreign(tmp_path / "b.mcap", rows[0])).joints == ("w",)


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "a.txt"
    empty = tmp_path / "b.mcap"
    text.write_text("hello")
    empty.write_bytes(b"\x89MCAP0\r\n")
    for path, why in (
        (tmp_path / "gone", "No such file"),
        (text, "neither an .mcap nor a .flight file"),
        (empty, "no message is in it: it ends at byte 8"),
        (tmp_path, "is a folder, not a file"),
    ):
        with pytest.raises(Rejected, match=why):
            open_recording(path)


def test_a_cut_recording_is_read_up_to_its_end_and_reported_as_damaged(tmp_path: Path) -> None:
    rig = SteppedWriter(tmp_path)
    rig.run(2.0)
    path = rig.writer.tally.path
    assert path is not None
    found = open_recording(path)
    assert 100 < found.time.size < 200 and "without its index" in found.damage


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> LoadedFlight:
    """A real loop and its bytes: armed, one motion, an e-stop."""
    folder = tmp_path_factory.mktemp("flown")
    rig = recording()
    rig.arm()
    rig.submit(rig.path("l_knee", [0.2], [0.5]))
    rig.seconds(0.8)
    taken = flight(rig, folder)
    rig.close()
    wall = {"wall_ns": START, "monotonic": 5.0, "buses": ["main"], "reason": "dump"}
    return LoadedFlight(wall, taken.briefing, taken.contents)


@pytest.fixture
def flight_file(flown: LoadedFlight, tmp_path: Path) -> Path:
    path = tmp_path / "a.flight"
    save(path, dict(flown.meta), msgspec.msgpack.encode(flown.briefing), flown.contents)
    return path


def test_a_flight_file_has_the_same_columns(flight_file: Path) -> None:
    found = open_recording(flight_file)
    knee = found.joints.index("l_knee")
    assert len(found.joints) == 24 and found.time[0] == 0.0 and (np.diff(found.time) > 0).all()
    assert found.live.all() and abs(found.measured[-1, knee] - 0.2) < 0.01
    assert abs(found.goal[-1, knee] - 0.2) < 1e-9 and found.meta["reason"] == "dump"
    assert found.statuses and found.slow is not None and "total" in found.latency
    assert found.robot is not None and found.mjcf and found.calibration


def test_torque_from_outside_is_read_from_recordings_and_from_each_tick_of_a_flight_file(
    flown: LoadedFlight, tmp_path: Path
) -> None:
    felt = {"external_nm": 1.5, "external_sd_nm": 0.2, "contact": True}
    found = record(tmp_path, state(100.0), state(100.6, **felt)).external
    assert found is not None and found.time.tolist() == [0.0, 0.6]
    assert np.isnan(found.torque[0]).all() and not found.contact[0].any()
    assert (found.torque[1] == 1.5).all() and (found.deviation[1] == 0.2).all() and found.contact[1].all()
    (tmp_path / "without").mkdir()
    assert record(tmp_path / "without", state(100.0)).external is None

    pressed = np.concatenate([np.full(24, -2.0), np.full(24, 0.1), np.ones(24)]).tobytes()
    older = np.concatenate([np.full(24, -2.0), np.full(24, 0.1)]).tobytes()
    for external, touched in ((pressed, True), (older, False)):
        path = tmp_path / f"{touched}.flight"
        entries = tuple(with_external(each, external) for each in flown.contents.entries)
        contents = FlightContents(flown.contents.kept, entries)
        save(path, dict(flown.meta), msgspec.msgpack.encode(flown.briefing), contents)
        whole = open_recording(path)
        found = whole.external
        assert found is not None and found.time.size >= whole.time.size - 15  # as for the first overview
        assert (found.torque == -2.0).all() and (found.deviation == 0.1).all()
        assert (found.contact == touched).all()


def with_external(entry: FlightEntry, external: bytes) -> FlightEntry:
    """Return the entry, with this torque from outside where it is a tick."""
    if entry.kind != EntryKind.NEWS or not isinstance(news := decode_news(entry.data), Tick):
        return entry
    return entry._replace(data=encode_news(msgspec.structs.replace(news, external=external)))


def test_an_exported_flight_is_the_same_recording_with_its_bytes(
    flight_file: Path, flown: LoadedFlight, tmp_path: Path
) -> None:
    out = tmp_path / "a.mcap"
    assert export(flight_file, out) > 100
    before = open_recording(flight_file)
    after = open_recording(out)
    later = (after.start_ns - before.start_ns) / 1e9
    rows = np.isin(np.round(before.time, 6), np.round(after.time + later, 6))
    assert rows.sum() == after.time.size >= before.time.size - 15  # before the first overview nothing is told
    heard = np.isfinite(after.measured).any(axis=1)  # rows of which nothing is known are left out
    assert heard.sum() > 0.9 * after.time.size
    for name in ("measured", "velocity", "effort", "goal", "simulated"):
        np.testing.assert_array_equal(getattr(after, name)[heard], getattr(before, name)[rows][heard])
    assert [each.what for each in after.events] == [each.what for each in before.events]
    (path,) = trajectories(out)
    assert path["joint_names"] == ["l_knee"] and path["id"] == before.verdicts[0].what["id"]
    assert [each.what for each in after.verdicts] == [each.what for each in before.verdicts]
    assert after.robot == before.robot and after.mjcf == before.mjcf
    file = McapRecordScanner(out)
    said = [
        json.loads(each.data)
        for each in file.contents()
        if isinstance(each, Message) and file.channels[each.channel_id].topic == "/twind/wire"
    ]
    wire = [each.data for each in flown.contents.entries if each.kind in (EntryKind.IN, EntryKind.OUT)]
    assert [bytes.fromhex(each["hex"]) for each in said if each["kind"] != "port"] == wire
    assert {each["bus"] for each in said} == {"main"}
    schema = json.loads(json_schemas()[WIRE])["properties"]
    ports = [each for each in said if each["kind"] == "port"]
    assert ports and all(each.keys() <= schema.keys() and each["text"] for each in ports)


def test_a_ros_export_has_a_single_encoding_and_the_same_content(flight_file: Path, tmp_path: Path) -> None:
    plain, ros, again = (tmp_path / f"{name}.mcap" for name in ("plain", "ros", "again"))
    export(flight_file, plain)
    export(flight_file, ros, ros=True)
    export(plain, again, ros=True)
    for path in (ros, again):
        with AnyReader([path]) as bag:
            types = {each.topic: each.msgtype for each in bag.connections}
            assert {each.ext.serialization_format for each in bag.connections} == {"cdr"}  # type: ignore[union-attr]
            events = [each for each in bag.connections if each.topic == "/twind/events"]
            texts = [bag.deserialize(data, each.msgtype).data for each, _, data in bag.messages(events)]
        assert types["/twind/events"] == "std_msgs/msg/String" and types["/hw/joint_states"] == JOINT_STATE
        found = open_recording(path)
        assert len(texts) == len(found.events) > 0
        assert [each.what for each in found.events] == [each.what for each in open_recording(plain).events]


def test_a_missing_flight_file_names_the_folder_of_dumps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    calls = (
        lambda: open_recording(tmp_path / "odd.flight"),
        lambda: export(tmp_path / "odd.flight", tmp_path / "odd.mcap"),
        lambda: replay.load_flight(tmp_path / "odd.flight"),
    )
    for call in calls:
        with pytest.raises(Rejected, match=f"No such file or directory; .*in {tmp_path}/state/flight"):
            call()


def test_an_export_that_finds_a_file_names_its_own_argument(tmp_path: Path) -> None:
    rig = SteppedWriter(tmp_path)
    rig.run(0.5)
    path = rig.writer.tally.path
    assert path is not None
    with pytest.raises(Rejected, match=r"name another OUT\.mcap"):
        export(path, path)


def test_nothing_is_written_over_by_an_export(flight_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "there.mcap"
    out.write_text("mine")
    for path in (flight_file, out):
        with pytest.raises(Rejected, match=r"is there already|is no MCAP file"):
            export(path, out)
    assert out.read_text() == "mine"


def with_state(path: Path, when: int, *more: tuple[str, bytes]) -> Path:
    """A recording of one JointState at `when` (ns), and of JSON messages."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(JOINT_STATE, "ros2msg", b"")
        message = {"header": {"stamp": stamp(START)}, "name": ["hip"], "position": [1.0]}
        states = writer.register_channel("/joint_states", "cdr", schema)
        writer.add_message(states, when, encode(JOINT_STATE, message), when)
        for topic, data in more:
            writer.add_message(writer.register_channel(topic, "json", 0), START, data, START)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("topic", "data"),
    [
        ("/twind/joints", b'{"joints": [1, 2]}'),
        ("/twind/joints", b'{"joints": [{"name": "hip", "temperature": "warm"}]}'),
        ("/twind/latency", b'{"hops": 7}'),
        ("/twind/events", b'{"annotation": "begin"}'),
        ("/twind/recording", b'{"annotation": [1]}'),
    ],
)
def test_a_file_with_other_message_formats_on_our_topics_is_refused(
    tmp_path: Path, topic: str, data: bytes
) -> None:
    with pytest.raises(Rejected, match=r"a\.mcap: .* is not in our format"):
        open_recording(with_state(tmp_path / "a.mcap", START, (topic, data)))


@pytest.mark.parametrize("when", [1 << 63, (1 << 64) - 1])
def test_an_impossible_time_is_refused(tmp_path: Path, when: int) -> None:
    with pytest.raises(Rejected, match="is not in our format"):
        open_recording(with_state(tmp_path / "b.mcap", when))


def test_a_model_attachment_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_attachment(0, 0, "model.mjcf", "application/xml", b"\xff\xfe")
        writer.add_message(writer.register_channel("/x", "", 0), START, b"", START)
        writer.finish()
    with pytest.raises(Rejected, match="UnicodeDecodeError"):
        open_recording(path)
