"""`twindctl record` beside a real daemon at 100 Hz: what it writes, what a kill, a disk and a restart leave.

One robot, four recorders and a witness that listens to the same daemon; then each claim by itself.
"""

import json
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from tests.support.processes import Daemon, daemon, favour, patiently, robot, until
from tests.support.sample_recordings import trajectories
from twind.client import Client, ClientError
from twind.client.clock_pair import ClockPair
from twind.observe.recording import open_recording
from twind.observe.recording.recording_columns import RobotRecording
from twind.observe.recover import recover

COLUMNS = {"position": "/hw/joint_states", "goal": "/hw/joint_commands", "simulated": "/sim/joint_states"}
SMALL = 100_000  # bytes that the recorder with the small disk may write


class StateRecorder:
    """Another client of the daemon: every answer of `Monitor` that it got, and when."""

    def __init__(self, running: Daemon) -> None:
        self.states: dict[float, list[dict[str, Any]]] = {}
        self.others: list[dict[str, Any]] = []
        self.over = False
        self._client = running.client
        topics = (["state"], 100.0), (["events", "verdicts", "trajectories"], None)
        self._threads = [threading.Thread(target=self._listen, args=each, daemon=True) for each in topics]
        for thread in self._threads:
            thread.start()

    def _listen(self, topics: list[str], rate: float | None) -> None:
        while not self.over:  # on a machine with too little time a slow reader is hung up on
            with suppress(ClientError), self._client() as client:
                for answer in client.stream("Monitor", topics=topics, rate=rate):
                    if answer["topic"] == "state":
                        self.states[answer["time"]] = answer["joints"]
                    else:
                        self.others.append(answer)
            time.sleep(0.05)


class RecordProcess:
    """A `twindctl record` process."""

    def __init__(self, running: Daemon, out: Path, *options: str, most: int | None = None) -> None:
        def limit() -> None:
            if most is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

        command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(running.sockets), "--json"]
        self.process = subprocess.Popen(
            [*command, "record", "--out", str(out), "--free", "0", *options],
            stdout=subprocess.PIPE,
            preexec_fn=limit,
        )
        favour(self.process)

    def end(self, number: int = signal.SIGTERM) -> tuple[int, dict[str, Any]]:
        """Exit code and what it said at its end."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        out, _ = self.process.communicate(timeout=20.0)
        return self.process.returncode, json.loads(out) if out else {}


def move(client: Client, path: dict[str, Any]) -> None:
    """Begin a motion."""
    client.call("AcquireLease")
    client.call("SubmitTrajectory", trajectory=path)


@contextmanager
def ended(recorders: dict[str, RecordProcess]) -> Iterator[None]:
    """None of them outlives the test."""
    try:
        yield
    finally:
        for each in recorders.values():
            if each.process.poll() is None:
                each.process.kill()
                each.process.communicate()


@dataclass
class Story:
    """Result of the run, for the tests."""

    folder: Path
    witness: StateRecorder
    killed: float = 0.0  # s, monotonic, just before SIGKILL
    ends: dict[str, tuple[int, dict[str, Any]]] = field(default_factory=dict)

    def files(self, name: str) -> list[Path]:
        return [Path(path) for path in self.ends[name][1]["files"]]


@pytest.fixture(scope="module")
def story() -> Iterator[Story]:
    """Mirror: the motors are measured, and a motion moves the simulation."""
    recorders: dict[str, RecordProcess] = {}
    with robot() as (virtual, folder), ended(recorders):
        with daemon(virtual, folder, mode="mirror") as running:
            running.reach(hw_connected=True)
            told = Story(folder, StateRecorder(running))
            recorders |= {
                "whole": RecordProcess(running, folder / "whole", "--task", "wave"),
                "killed": RecordProcess(running, folder / "killed"),
                "small": RecordProcess(running, folder / "small", most=SMALL),
                "timed": RecordProcess(running, folder / "timed" / "one.mcap", "--seconds", "1.5"),
            }
            for name in ("whole", "killed"):
                until(lambda name=name: list((folder / name).glob("*.mcap")), 20.0, f"{name} records")
            with running.client() as client:
                steps = ((0.3, 0.8), (0.1, 1.4))
                points = [{"positions": [angle], "time_from_start": time} for angle, time in steps]
                path = {"joint_names": ["l_knee"], "points": points}
                patiently(lambda: move(client, path))
                time.sleep(1.6)
            told.killed = time.monotonic()
            recorders["killed"].process.kill()
            recorders["killed"].process.communicate()
            told.ends["small"] = recorders["small"].end(signal.SIGCONT)  # it has ended by itself
            told.ends["timed"] = recorders["timed"].end(signal.SIGCONT)
            told.witness.over = True
            assert running.end() == 0
        with daemon(virtual, folder, mode="mirror") as running:
            running.reach(hw_connected=True)
            until(lambda: len(list((folder / "whole").glob("*.mcap"))) == 2, 20.0, "the second file")
            time.sleep(0.7)
            told.ends["whole"] = recorders["whole"].end(signal.SIGINT)
        yield told


def known(path: Path, observed: StateRecorder) -> dict[int, list[dict[str, Any]]]:
    """Messages of the second subscriber, by log time."""
    about = open_recording(path).meta
    clocks = ClockPair(float(about["monotonic"]), int(about["wall_ns"]))
    return {clocks.wall(time): joints for time, joints in list(observed.states.items())}


def column(joints: list[dict[str, Any]], name: str) -> list[float | None]:
    return [joint[name] for joint in joints]


def numbers(row: Any) -> list[float | None]:
    return [None if isnan(each) else float(each) for each in row]


def equal_to_what_was_sent(rows: list[tuple[str, int, Any]], sent: dict[int, list[dict[str, Any]]]) -> None:
    """(topic, log time, JointState) of a reader; some the witness heard too: those are equal."""
    for name, topic in COLUMNS.items():
        found = [(time, message) for where, time, message in rows if where == topic]
        both = [(message, sent[time]) for time, message in found if time in sent]
        assert len(both) > 50
        for message, joints in both:
            assert list(message.name) == column(joints, "name")
            assert numbers(message.position) == column(joints, name)
            if name == "position":
                assert numbers(message.velocity) == column(joints, "velocity")
                assert numbers(message.effort) == column(joints, "effort")


def test_mcaps_own_readers_decode_what_the_daemon_sent(story: Story) -> None:
    path = story.files("whole")[0]
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        rows = [
            (channel.topic, message.log_time, decoded)
            for _, channel, message, decoded in reader.iter_decoded_messages(topics=list(COLUMNS.values()))
        ]
    equal_to_what_was_sent(rows, known(path, story.witness))
    for _, time_ns, message in rows:
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time_ns


def test_rosbags_decodes_what_the_daemon_sent(story: Story) -> None:
    path = story.files("whole")[0]
    with AnyReader([path]) as bag:
        states = [each for each in bag.connections if each.topic in COLUMNS.values()]
        assert {each.msgtype for each in states} == {"sensor_msgs/msg/JointState"}
        rows = [
            (each.topic, time, bag.deserialize(data, each.msgtype))
            for each, time, data in bag.messages(states)
        ]
    equal_to_what_was_sent(rows, known(path, story.witness))


def test_the_columns_are_what_the_daemon_sent(story: Story) -> None:
    path = story.files("whole")[0]
    found = open_recording(path)
    sent = known(path, story.witness)
    assert not found.damage and found.robot is not None and found.mjcf
    assert found.meta["robot"] == "h24" and found.meta["mode"] == "mirror"
    both = 0
    for row, time_ns in enumerate(round(each * 1e9) + found.start_ns for each in found.time):
        joints = sent.get(time_ns)
        if joints is not None:
            both += 1
            assert numbers(found.measured[row]) == column(joints, "position")
            assert numbers(found.goal[row]) == column(joints, "goal")
            assert numbers(found.simulated[row]) == column(joints, "simulated")
    assert both > 50
    spanned = [time for time in sent if found.start_ns <= time <= found.start_ns + found.time[-1] * 1e9]
    stamps = {round(each * 1e9) + found.start_ns for each in found.time}
    said = story.ends["whole"][1]
    assert len(set(spanned) - stamps) <= said["dropped"] + said["dropped_by_daemon"]
    assert found.slow is not None and found.slow.temperature.shape[1] == 24
    assert found.latency["total"].time.size > 10 and not found.live.any()


def test_published_trajectories_and_events_are_in_the_recording(story: Story) -> None:
    found = open_recording(story.files("whole")[0])
    (path,) = trajectories(story.files("whole")[0])
    (heard,) = [each for each in story.witness.others if each["topic"] == "trajectories"]
    assert path["id"] == heard["accepted"]["id"]
    sent = heard["accepted"]["trajectory"]
    assert path["joint_names"] == sent["joint_names"]
    goals = [[each["positions"] for each in points] for points in (path["points"], sent["points"])]
    assert goals[0] == goals[1]
    verdicts = [each for each in story.witness.others if each["topic"] == "verdicts"]
    told = [{"id": each["id"], **each["verdict"]} for each in verdicts]
    assert [each.what for each in found.verdicts] == told
    events = [each for each in story.witness.others if each["topic"] == "events"]
    events = [each["event"]["sequence"] for each in events if each["time"] < story.killed]
    assert {each.what["sequence"] for each in found.events} >= set(events[-3:])


def test_a_restart_of_the_daemon_is_a_new_file_and_the_episode_goes_on(story: Story) -> None:
    code, said = story.ends["whole"]
    first, second = (open_recording(path) for path in story.files("whole"))
    assert code == 0 and said["stopped"] is None and said["dropped"] == 0
    assert first.start_ns + first.time[-1] * 1e9 < second.start_ns and second.time.size > 30
    assert not first.damage and not second.damage
    assert [each.task for each in first.episodes] == ["wave"] and isnan(first.episodes[0].end)
    ends = [each for each in second.episodes if not isnan(each.end)]
    assert said["episodes"] == len(ends) == 1


def test_a_kill_loses_less_than_a_second_and_the_rest_recovers(story: Story) -> None:
    (path,) = (story.folder / "killed").glob("*.mcap")
    cut = open_recording(path)
    assert cut.damage
    found = recover(path)
    assert found.out is not None and str(found.out).endswith("-recovered.mcap")
    whole = open_recording(found.out)
    assert not whole.damage and whole.time.size == cut.time.size
    about = ClockPair(float(whole.meta["monotonic"]), int(whole.meta["wall_ns"]))
    last = whole.start_ns + round(whole.time[-1] * 1e9)
    heard = max(time for time in story.witness.states if time <= story.killed)
    assert about.wall(heard) - last <= 1_000_000_000
    begins = whole.start_ns
    sent = known(found.out, story.witness)
    expected = [time for time in sent if begins <= time <= last]
    stamps = {round(each * 1e9) + begins for each in whole.time}
    told = sum(note.what["count"] for note in whole.notes if note.what["kind"] == "dropped")
    assert len(expected) > 50 and len(set(expected) - stamps) <= told


def test_a_full_disk_stops_it_with_a_reason_and_leaves_a_readable_file(story: Story) -> None:
    code, said = story.ends["small"]
    (path,) = story.files("small")
    assert code == 1 and "File too large" in said["stopped"] and str(path) in said["stopped"]
    assert path.stat().st_size <= SMALL
    found: RobotRecording = open_recording(path)
    with path.open("rb") as stream:
        rows = list(make_reader(stream).iter_messages(topics="/hw/joint_states"))
    assert len(rows) == int(np.isfinite(found.measured).any(axis=1).sum())
    assert len(rows) > 10, f"{said['messages']} messages, {said['dropped']} dropped, {said['seconds']} s"
    assert recover(path).messages >= len(rows)


def test_a_recording_ends_after_the_requested_seconds(story: Story) -> None:
    code, said = story.ends["timed"]
    found = open_recording(story.folder / "timed" / "one.mcap")
    assert code == 0 and 1.5 <= said["seconds"] < 3.5 and 0.8 < found.duration < 3.5
