"""Peer bridges that take commands in a graph are known by their status, and gone when it stops."""

import json
from typing import Any

import pytest

from twind.bridge.ros.peer_bridges import MOST, SILENT, PeerBridges
from twind.ros import STRING, encode


def bridge_status(**bridge: Any) -> bytes:
    return encode(STRING, {"data": json.dumps({"robot": "right", "bridge": bridge})})


def test_another_that_takes_commands_is_named_with_the_remedy_until_it_is_silent() -> None:
    time = [100.0]
    neighbours = PeerBridges(lambda: time[0])
    neighbours.on_bridge_status(bridge_status(id="abc", commands=True))
    assert (
        "right (bridge abc)" in neighbours.conflict_text() and "ROS_DOMAIN_ID" in neighbours.conflict_text()
    )
    time[0] += SILENT
    assert not neighbours.conflict_text()


def test_neither_ourselves_nor_who_only_looks_nor_who_ended_is_another() -> None:
    neighbours = PeerBridges()
    neighbours.on_bridge_status(bridge_status(id=neighbours.id, commands=True))
    neighbours.on_bridge_status(bridge_status(id="looks", commands=False))
    neighbours.on_bridge_status(bridge_status(id="ends", commands=True))
    neighbours.on_bridge_status(bridge_status(id="ends", commands=False))
    assert not neighbours.conflict_text()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"bridge": 7}', '{"bridge": null}', "[" * 100_000])
def test_an_invalid_bridge_status_reports_no_peer(text: str) -> None:
    neighbours = PeerBridges()
    neighbours.on_bridge_status(encode(STRING, {"data": text}))
    neighbours.on_bridge_status(text.encode())
    assert not neighbours.conflict_text()


def test_the_number_of_known_peer_bridges_is_bounded() -> None:
    neighbours = PeerBridges()
    for number in range(10 * MOST):
        neighbours.on_bridge_status(bridge_status(id=str(number), commands=True))
    assert neighbours.conflict_text().count("(bridge ") == MOST
