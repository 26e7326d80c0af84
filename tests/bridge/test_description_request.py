"""The description of a robot on the graph is that of the daemon that is there, or none."""

import threading
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from twind.bridge.ros import description_request
from twind.bridge.ros.description_request import DescriptionRequest
from twind.bridge.ros.robot_model_messages import RobotModelMessages
from twind.exceptions import OperationFailed

ROBOT = RobotModelMessages("<robot/>", [])


class Answers:
    """Gives one answer after the other; an exception is raised."""

    def __init__(self, *answers: Any) -> None:
        self.left = list(answers)
        self.published: list[object] = []
        self.reported: list[str] = []
        self.lives = 1
        self.publish: Callable[[object], None] = self.published.append
        self.request = DescriptionRequest(
            lambda: nullcontext(SimpleNamespace(call=lambda method: {})),  # type: ignore[arg-type, return-value]
            self.describe,
            lambda found: self.publish(found),
            lambda: self.lives,
            self.reported.append,
            threading.Event(),
        )

    def describe(self, answer: object) -> RobotModelMessages:
        found = self.left.pop(0)
        if isinstance(found, Exception):
            raise found
        if isinstance(found, int):
            self.lives = found
            return ROBOT
        assert isinstance(found, RobotModelMessages)
        return found


@pytest.fixture(autouse=True)
def no_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(description_request, "AGAIN", 0.0)


def test_a_failed_request_withdraws_the_description_and_is_made_again() -> None:
    answers = Answers(
        OperationFailed("timed out"), OperationFailed("timed out"), ValueError("no JSON"), ROBOT
    )
    answers.request.run(1)
    assert answers.published == [None, ROBOT]
    assert len(answers.reported) == 2


def test_a_thread_of_an_older_daemon_withdraws_nothing() -> None:
    answers = Answers(ROBOT)
    answers.lives = 2
    answers.request.run(2)
    answers.request.run(1)  # its thread begins late
    assert answers.published == [None, ROBOT]


def test_a_description_that_is_being_published_is_withdrawn_by_a_newer_daemon_afterwards() -> None:
    answers = Answers(ROBOT, ROBOT)
    publishing = threading.Event()
    withdrawn = threading.Event()
    published: list[object] = []

    def publish(found: object) -> None:
        if found is not None and not publishing.is_set():
            publishing.set()
            withdrawn.wait(0.2)  # the newer thread would withdraw it meanwhile
        published.append(found)
        if answers.lives == 2 and found is None:
            withdrawn.set()

    answers.publish = publish
    answers.request.start(1)
    assert publishing.wait(10.0)
    answers.lives = 2
    answers.request.run(2)
    assert published == [None, ROBOT, None, ROBOT]


def test_an_answer_of_a_daemon_that_is_gone_is_not_published() -> None:
    answers = Answers(2)
    answers.request.run(1)
    assert answers.published == [None]
