"""The description of a robot on the graph is that of the daemon that is there, or none."""

import threading
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
        self.request = DescriptionRequest(
            lambda: nullcontext(SimpleNamespace(call=lambda method: {})),  # type: ignore[arg-type, return-value]
            self.describe,
            self.published.append,
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


def test_an_answer_of_a_daemon_that_is_gone_is_not_published() -> None:
    answers = Answers(2)
    answers.request.run(1)
    assert answers.published == [None]
