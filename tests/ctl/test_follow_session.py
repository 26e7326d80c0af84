"""A follower whose leader is lost says so, however its connection ends."""

from collections.abc import Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from twind.client import ClientError, NoAnswer, NoDaemon
from twind.ctl.following.follow_session import _run


def leader_that_ends_with(error: ClientError) -> Any:
    def states(*, patience: float) -> Iterator[Any]:
        raise error
        yield

    return SimpleNamespace(states=states)


@pytest.mark.parametrize("error", [NoAnswer("no state"), NoDaemon("no daemon"), ClientError("closed")])
def test_a_leader_that_is_lost_ends_the_following_with_its_reason(error: ClientError) -> None:
    stream: Any = nullcontext(SimpleNamespace())
    assert _run(leader_that_ends_with(error), [], stream) == str(error)
