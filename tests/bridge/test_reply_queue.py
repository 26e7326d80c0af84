"""Queue of remote replies, ordered and bounded: answers stay, news may be dropped and are then counted."""

import json
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.fleet.client_reply_queue import ClientReplyQueue
from twind.client import Disconnected


def news(number: int, dropped: int = 0, size: int = 10) -> bytes:
    told = {"parameters": {"dropped": dropped, "number": number, "filler": "x" * size}, "continues": True}
    return json.dumps(told).encode()


def parameters(message: bytes) -> dict[str, int]:
    found: dict[str, int] = json.loads(message)["parameters"]
    return found


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3), st.integers(0, 200)), max_size=60))
def test_answers_always_come_in_order_and_every_piece_of_news_comes_or_is_counted(
    put: list[tuple[bool, int, int]],
) -> None:
    inbox = ClientReplyQueue(room=600)
    for number, (is_news, dropped, size) in enumerate(put):
        (inbox.put_news if is_news else inbox.answer)(news(number, dropped if is_news else 0, size))
    came = [parameters(message) for message in inbox.rest()]
    numbers = [each["number"] for each in came]
    assert numbers == sorted(numbers)
    assert {number for number, (is_news, _, _) in enumerate(put) if not is_news} <= set(numbers)
    lost_here = len(put) - len(came)
    # What was lost behind the last piece that came is told with the next one.
    inbox.put_news(news(len(put)))
    last = inbox.take(0.0)
    assert last is not None
    told_lost = sum(each["dropped"] for each in came) + parameters(last)["dropped"]
    said = sum(put[each][1] for each in numbers if put[each][0])
    assert told_lost == said + lost_here


def test_a_message_that_comes_later_is_waited_for_and_none_is_an_answer_too() -> None:
    inbox = ClientReplyQueue()
    assert inbox.take(0.0) is None
    timer = threading.Timer(0.05, inbox.answer, [b"{}"])
    timer.start()
    assert inbox.take(20.0) == b"{}"
    timer.join()


def test_replies_received_before_the_end_are_taken_before_the_end() -> None:
    inbox = ClientReplyQueue()
    inbox.answer(b"{}")
    inbox.end("it went away")
    inbox.end("and this is no better reason")
    assert inbox.take(0.0) == b"{}"
    with pytest.raises(Disconnected, match=r"^it went away$"):
        inbox.take(time.monotonic())


@pytest.mark.parametrize("odd", [b'{"parameters": {"n": 1}}', b"\xff", b"[]", b"{}", b'{"parameters": null}'])
def test_news_without_a_drop_count_pass_unchanged(odd: bytes) -> None:
    inbox = ClientReplyQueue(room=100)
    inbox.put_news(b"x" * 101)
    inbox.put_news(odd)
    last = inbox.take(0.0)
    assert last == odd or (last is not None and parameters(last) == {"n": 1, "dropped": 1})
