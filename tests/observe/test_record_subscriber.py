"""Subscriber to the recorded daemon: unreadable messages and reloads."""

import argparse
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import until
from tests.support.sample_recordings import JOINTS, event, joint, state
from twind.client import Disconnected
from twind.observe import record
from twind.observe.recording import open_recording
from twind.observe.writing import record_subscriber as record_daemon
from twind.observe.writing.record_folder import DiskQuota
from twind.observe.writing.record_subscriber import RecordSubscriber
from twind.observe.writing.record_writer import RecordWriter
from twind.observe.writing.recorder import Recorder

RUBBISH = {"topic": "state", "time": 101.0, "dropped": 0, "joints": [{"name": "hip"}]}


class Robot:
    """Stand-in for a daemon. `says`: messages of streams by topic; each stream then waits for `over`."""

    def __init__(self) -> None:
        self.robot: dict[str, Any] = {"name": "two", "limit": 1}
        self.joints = list(JOINTS)
        self.connections = 0
        self.over = threading.Event()
        self.says: dict[str, list[Any]] = {}

    def client(self, _options: Any) -> "Robot":
        return self

    def __enter__(self) -> "Robot":
        return self

    def __exit__(self, *_: object) -> None: ...

    def close(self) -> None: ...

    def call(self, method: str, **_: Any) -> dict[str, Any]:
        known = {"robot": "two", "version": "0", "mode": "live", "loop": {"rate_hz": 100.0}}
        joints = [joint(name, 0.0) for name in self.joints]
        return {
            "GetStatus": {"status": known, "joints": joints},
            "GetRobot": {"robot": self.robot},
            "GetParameters": {"parameters": {}},
        }[method]

    def stream(self, _method: str, topics: list[str], **_: Any) -> Iterator[dict[str, Any]]:
        self.connections += topics == ["state"]
        for each in self.says.get(topics[0], ()):
            yield each() if callable(each) else each
        self.over.wait(5.0)
        raise Disconnected("gone")


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Iterator[Robot]:
    found = Robot()
    monkeypatch.setattr(record_daemon, "observer", found.client)
    yield found
    found.over.set()


def writer(folder: Path) -> RecordWriter:
    return RecordWriter(folder, DiskQuota(1 << 40, 0, 1 << 40), lambda: 100.0)


def test_an_unreadable_message_ends_the_subscription_and_counts_as_lost(tmp_path: Path, robot: Robot) -> None:
    robot.says = {"state": [state(100.0), RUBBISH, state(102.0)]}
    into = writer(tmp_path)
    listening = RecordSubscriber(argparse.Namespace(), into)
    until(lambda: listening.ended, 5.0, "the end of the subscription")
    assert listening.ended == "a message is unreadable: KeyError: 'position'"
    assert isinstance(listening.failure, KeyError)
    into.close()
    assert into.tally.missed == 1 and open_recording(into.tally.files[0]).time.size == 1
    robot.over.set()
    listening.close()


def test_the_recorder_reconnects_and_reports_the_error_once(
    tmp_path: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("twind.observe.writing.recorder.AGAIN", 0.01)
    robot.says = {"state": [RUBBISH]}
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", action="store_true")
    record.add_arguments(parser)
    robot.over.set()
    assert Recorder(parser.parse_args(["--seconds", "0.7"]), writer(tmp_path), threading.Event()).run() == 0
    said = capsys.readouterr().err
    assert robot.connections > 1 and said.count("Traceback") == 1 and "KeyError: 'position'" in said


def test_after_a_reload_the_next_file_has_what_is_in_force_now(tmp_path: Path, robot: Robot) -> None:
    def reload() -> dict[str, Any]:
        robot.robot = {"name": "two", "limit": 2}
        return event(101.0, "RELOADED")

    robot.says = {"status": [event(100.0, "ARMED"), reload, event(102.0, "ESTOP"), event(103.0, "ESTOP")]}
    into = writer(tmp_path)
    listening = RecordSubscriber(argparse.Namespace(), into)
    robot.over.set()
    until(lambda: listening.answers == 4, 5.0, "all answers")
    listening.close()
    into.close()
    first, second = (open_recording(path) for path in into.tally.files)
    assert (first.robot, second.robot) == ({"name": "two", "limit": 1}, {"name": "two", "limit": 2})
    assert [each.what["code"] for each in first.events] == ["ARMED", "RELOADED"]
    assert [each.what["code"] for each in second.events] == ["ESTOP", "ESTOP"]


def test_a_robot_with_other_joints_after_a_reload_ends_the_subscription(tmp_path: Path, robot: Robot) -> None:
    def reload() -> dict[str, Any]:
        robot.joints = ["hip"]
        return event(101.0, "RELOADED")

    robot.says = {"status": [reload, event(102.0, "ESTOP")]}
    into = writer(tmp_path)
    listening = RecordSubscriber(argparse.Namespace(), into)
    until(lambda: listening.ended, 5.0, "the end of the subscription")
    assert listening.ended == "the robot has other joints now" and listening.failure is None
    into.close()
    assert len(into.tally.files) == 1
    robot.over.set()
    listening.close()
