"""The daemon that is recorded: what it is, and two connections that listen, each in a thread of its own."""

import argparse
import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from twind.client import Client, ClientError
from twind.client.clock_pair import ClockPair, clocks
from twind.command_line.verb import observer
from twind.observe.writing.record_encoder import RecordEncoder
from twind.observe.writing.record_schemas import attachments
from twind.observe.writing.record_writer import RecordSession, RecordWriter
from twind.robot.event_codes import EventCode

SILENCE = 5.0  # s without a message after which the daemon counts as gone
OTHERS = ("status", "latency", "events", "verdicts", "trajectories")  # each at its own rate


class RecordSubscriber:
    """Subscription to a daemon, from `__init__` to `close`. `ended`: why it is over before that.

    `failure`: the exception that ended it: a defect of twind, or an unreadable message.
    """

    def __init__(self, options: argparse.Namespace, writer: RecordWriter) -> None:
        """Begins a session of `writer`. Raises ClientError."""
        self._options = options
        self._writer = writer
        self.ended = ""
        self.failure: Exception | None = None
        self._stop = threading.Event()
        self.answers = 0
        state, others = (self._client(options) for _ in range(2))
        try:
            self.session, joints = self._ask(state, clocks())
            self.scribe = RecordEncoder(joints, self.session.clocks, self.session.about["mode"])
            streams = [
                (state, state.stream("Monitor", topics=["state"], rate=float(self.session.about["rate_hz"]))),
                (others, others.stream("Monitor", topics=list(OTHERS))),
            ]
        except ClientError:
            state.close()
            others.close()
            raise
        writer.begin(self.session)
        self._threads = [
            threading.Thread(target=self._listen, args=each, name="listening", daemon=True)
            for each in streams
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Disconnect. The writer has all received messages."""
        self._stop.set()
        for thread in self._threads:
            thread.join(1.0)

    def _ask(self, client: Client, clocks: ClockPair) -> tuple[RecordSession, list[str]]:
        """Ask for the robot and the names of its joints."""
        status = client.call("GetStatus", joints=True)
        robot = client.call("GetRobot")
        individual = client.call("GetParameters")["parameters"].get("individual")
        known = status["status"]
        about = _about(known, individual)
        files = attachments(robot["robot"], robot.get("calibration"), robot.get("mjcf"))
        names = [joint["name"] for joint in status["joints"]]
        return RecordSession(known["robot"], clocks, about, files), names

    def _ask_again(self) -> None:
        """A file is of one robot file: the next begins, with what is in force now. Raises ClientError."""
        with self._client(self._options) as client:
            session, joints = self._ask(client, self.session.clocks)
        if tuple(joints) != self.scribe.joints:
            self.ended = "the robot has other joints now"
            return
        self.session = replace(session, why="the robot was reloaded")
        self._writer.begin(self.session)

    def _client(self, options: argparse.Namespace) -> Client:
        client = observer(options)
        client.timeout = SILENCE
        return client

    def _listen(self, client: Client, stream: Any) -> None:
        try:
            for answer in stream:
                if answer["dropped"]:
                    self._writer.missed(answer["dropped"])
                for line in self.scribe.take(answer):
                    self._writer.put(line)
                self.answers += 1
                if answer["topic"] == "events" and answer["event"]["code"] == EventCode.RELOADED:
                    self._ask_again()
                if self._stop.is_set() or self.ended:
                    break
        except ClientError as error:
            self.ended = self.ended or str(error)
        except Exception as error:  # noqa: BLE001  a thread that dies in silence goes on "recording"
            self._writer.missed(1)
            self.failure = self.failure or error
            self.ended = self.ended or f"a message is unreadable: {type(error).__name__}: {error}"
        else:
            if not self._stop.is_set():
                self.ended = self.ended or "the daemon ended the stream"
        finally:
            client.close()


def _about(status: Mapping[str, Any], individual: Any) -> dict[str, str]:
    return {
        "version": str(status["version"]),
        "robot": str(status["robot"]),
        "individual": str(individual or ""),
        "mode": str(status["mode"]),
        "rate_hz": str(status["loop"]["rate_hz"]),
    }
