"""A new page reads the messages that are left, not every number that was ever given to one."""

import asyncio
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("viser", reason="the extra `view` is not installed")

from viser import _messages
from viser.infra import _async_message_buffer

from twind.observe.viewing.page_backlog import shorten_backlog

END = "the end of the backlog"


class CountedMessages(dict[int, Any]):
    """Messages by their numbers, and how many numbers were looked up."""

    looked_up = 0

    def get(self, number: int, otherwise: Any = None) -> Any:
        """As of a dict."""
        self.looked_up += 1
        return super().get(number, otherwise)


def title(name: str) -> Any:
    """A message that replaces the one before with the same name."""
    return _messages.RemoveSceneNodeMessage(name)


async def read_by(buffer: Any, pushed_later: Sequence[str], most: int) -> list[str]:
    """Names that a new page reads: the backlog, its end, and what is pushed after it has connected."""
    generator = buffer.window_generator(7, backlog_done_message=title(END))
    found: list[str] = []
    for name in pushed_later:
        buffer.push(title(name))
    buffer.flush()
    while len(found) < most:
        found += [each.name for each in await asyncio.wait_for(anext(generator), 10.0)]
    assert buffer.generator_cursors == {7: buffer.message_counter - 1}, "what it has read may be removed"
    await generator.aclose()
    assert not buffer.generator_cursors
    return found


async def filled_buffer(names: Sequence[str]) -> Any:
    buffer = _async_message_buffer.AsyncMessageBuffer(asyncio.get_running_loop(), persistent_messages=True)
    for name in names:
        buffer.push(title(name))
    return buffer


NAMES = st.lists(st.sampled_from(list("abcdefgh")), max_size=30)


@given(before=NAMES, later=NAMES)
def test_a_page_reads_the_same_as_from_viser_itself(before: list[str], later: list[str]) -> None:
    async def both() -> tuple[list[str], list[str]]:
        most = len(set(before) | set(later)) + 1
        own = await filled_buffer(before)
        shorten_backlog(own)
        return await read_by(await filled_buffer(before), later, most), await read_by(own, later, most)

    vis, own = asyncio.run(both())
    assert own == vis


def test_a_page_looks_up_no_more_numbers_than_there_are_messages() -> None:
    async def looked_up() -> int:
        buffer = await filled_buffer(["a", "b", *["c"] * 5000])
        buffer.message_from_id = CountedMessages(buffer.message_from_id)
        shorten_backlog(buffer)
        await read_by(buffer, ["d", "e"], 6)
        count: int = buffer.message_from_id.looked_up
        return count

    assert asyncio.run(looked_up()) == 5


def test_a_buffer_of_another_viser_is_left_as_it_is() -> None:
    class Other:
        """A buffer without these methods."""

    other = Other()
    shorten_backlog(other)
    assert not vars(other)
