"""Replies of the loop to marks: an end says whether an episode was open."""

from typing import Any

from twind import link
from twind.loop.ipc.responder import Responder
from twind.robot.event_codes import EventCode
from twind_drivers.clock import FakeClock


class SentReplies:
    """In place of the link: replies."""

    def __init__(self) -> None:
        self.replies: list[link.Reply] = []

    def sequence(self) -> int:
        return 1

    def event(self, _event: link.Event) -> None:
        """Drop it."""

    def reply(self, reply: link.Reply) -> None:
        self.replies.append(reply)


def test_an_end_says_whether_an_episode_was_open() -> None:
    sent = SentReplies()
    responder = Responder(sent, FakeClock())  # type: ignore[arg-type]

    def mark(kind: str, **fields: Any) -> object:
        command = link.Mark(ticket=1, client=1, annotation=link.Annotation(kind, **fields))
        responder.mark(command, EventCode.NOTE, "")
        return sent.replies[-1].parameters.get("was_open")

    assert mark("end") is False
    assert mark("begin", task="pick") is None
    assert mark("note", text="it slips") is None
    assert mark("end") is True
    assert mark("end") is False
