"""Annotations of clients: fields of each kind, and the event that each one becomes."""

from typing import Any

import pytest

from tests.support.daemon_rig import Rig
from twind import link
from twind.exceptions import InvalidInput
from twind.front.annotations import LONGEST, annotation
from twind.link import Annotation
from twind.loop.procedures.command_handlers import MARKS


def make_annotation(kind: str, **given: Any) -> Annotation:
    return annotation({"kind": kind} | given)


def wrong(kind: str, **given: Any) -> str:
    with pytest.raises(InvalidInput) as caught:
        make_annotation(kind, **given)
    return caught.value.where


def test_each_kind_has_its_own_fields() -> None:
    assert make_annotation("begin", task="pick", text=None) == Annotation("begin", task="pick")
    assert make_annotation("begin", task="pick", text="red cube").text == "red cube"
    assert make_annotation("end", success=False) == Annotation("end", success=False)
    assert make_annotation("end") == Annotation("end")
    assert make_annotation("end", task="pick", success=True).task == "pick"
    assert make_annotation("note", text="the gripper slips") == Annotation("note", text="the gripper slips")


@pytest.mark.parametrize(
    ("kind", "given", "field"),
    [
        ("begin", {}, "task"),
        ("begin", {"text": "t"}, "task"),
        ("begin", {"task": "pick", "success": False}, "success"),
        ("note", {}, "text"),
        ("note", {"text": "t", "task": "pick"}, "task"),
        ("note", {"text": "t", "success": False}, "success"),
    ],
)
def test_a_field_too_many_or_too_few_is_named(kind: str, given: dict[str, Any], field: str) -> None:
    assert wrong(kind, **given) == field


@pytest.mark.parametrize("text", ["", "   ", "two\nlines", "\x1b[31m", "‮"])
def test_an_annotation_text_that_is_no_printable_line_is_refused(text: str) -> None:
    assert wrong("begin", task=text) == "task"
    assert wrong("note", text=text) == "text"


@pytest.mark.parametrize("field", LONGEST)
def test_the_longest_text_passes_and_one_character_more_does_not(field: str) -> None:
    most = LONGEST[field]
    given = {"task": "pick", field: "ü" * most}
    assert getattr(make_annotation("begin", **given), field) == "ü" * most
    assert wrong("begin", **given | {field: "ü" * (most + 1)}) == field


SAID = {
    Annotation("begin", task="pick"): "pick",
    Annotation("begin", task="pick", text="red cube"): "pick: red cube",
    Annotation("end", success=True): "succeeded",
    Annotation("end", task="pick", success=False, text="dropped"): "pick: failed: dropped",
    Annotation("end"): "ended",
    Annotation("note", text="slips"): "slips",
}


def test_each_annotation_becomes_an_event_and_the_reply_names_its_sequence(live: Rig) -> None:
    for given, message in SAID.items():
        live.news.clear()
        reply = live.call(link.Mark, annotation=given, ticks=2)
        (event,) = live.events(MARKS[given.kind])
        assert (event.message, event.level, event.holder) == (message, "info", "test")
        assert event.annotation == given
        assert reply.parameters["sequence"] == event.sequence


def test_the_reply_to_an_end_says_whether_an_episode_was_open(live: Rig) -> None:
    def mark(kind: str, **given: Any) -> object:
        reply = live.call(link.Mark, annotation=Annotation(kind, **given), ticks=2)
        return reply.parameters.get("was_open")

    assert mark("end") is False
    assert mark("begin", task="pick") is None
    assert mark("note", text="it slips") is None
    assert [mark("end"), mark("end")] == [True, False]
