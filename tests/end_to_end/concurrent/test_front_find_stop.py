"""`FindStop` through the front: who is asked, and what it is told on the way."""

from collections.abc import Iterator

import pytest

from tests.support.loop_stand_in import NAMES, StandIn
from twind import link
from twind.client import CallError, Client


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StandIn]:
    stand_in = StandIn(tmp_path_factory.mktemp("front"))
    yield stand_in
    assert stand_in.close() == 0


def test_find_stop_reaches_the_loop_by_joint_index_and_its_phases_return(loop: StandIn) -> None:
    def answer(command: link.Command) -> list[link.Reply]:
        told = [
            {"phase": "approaching", "progress": 0.5},
            {"phase": "found", "progress": 1.0, "ticks": [1, 2]},
        ]
        return [
            link.Reply(ticket=command.ticket, parameters=each, continues=each is not told[-1])
            for each in told
        ]

    loop.answers[link.FindStop] = answer
    with Client(str(loop.directory)) as client:
        answers = list(client.stream("FindStop", joint=NAMES[1], side="upper", speed=0.1, times=4))
    command = loop.await_command(link.FindStop)
    assert [each["phase"] for each in answers] == ["approaching", "found"]
    assert answers[-1]["ticks"] == [1, 2]
    assert isinstance(command, link.FindStop)
    assert (command.joint, command.side, command.speed, command.times) == (1, "upper", 0.1, 4)
    assert command.current_share is None and command.more


@pytest.mark.parametrize(
    ("how", "what"),
    [({"joint": "nobody", "side": "lower"}, "joint"), ({"joint": NAMES[0], "side": "left"}, "side")],
)
def test_an_unknown_joint_or_side_is_reported_with_the_valid_ones(
    loop: StandIn,
    how: dict[str, str],
    what: str,
) -> None:
    loop.commands.clear()
    with Client(str(loop.directory)) as client, pytest.raises(CallError) as told:
        client.call("FindStop", **how)
    assert told.value.name == "NotFound" and told.value.parameters["what"] == what
    assert len(told.value.parameters["known"]) == (len(NAMES) if what == "joint" else 2)
    assert not [command for command in loop.commands if isinstance(command, link.FindStop)]
