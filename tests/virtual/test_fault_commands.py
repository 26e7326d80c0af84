import inspect
import json
import os
import re
import socket
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from twind.exceptions import InvalidInput
from twind.virtual.fault_commands import BODY_FAULTS, FaultCommandSocket, Order, arguments
from twind.virtual.virtual_main import parser
from twind_drivers.can.can_twin import CAN_FAULTS
from twind_drivers.dynamixel.servo_twin import FAULTS
from twind_drivers.virtual.can.can_bus_faults import CanFaults
from twind_drivers.virtual.serial_bus_faults import SerialBusFaults


@pytest.mark.parametrize(
    ("order", "says"),
    [
        ({}, "an order names a fault or a query"),
        ({"fault": "melt"}, "no fault 'melt'"),
        ({"fault": "drop"}, "drop needs count"),
        ({"fault": "drop", "count": True}, "count is True"),
        ({"fault": "drop", "count": 1.5}, "count is 1.5"),
        ({"fault": "silence", "id": 1, "on": 1}, "on is 1"),
        ({"fault": "unplug", "id": 1}, "unplug takes no arguments, not 'id'"),
        ({"fault": ["drop"]}, "no fault"),
    ],
)
def test_an_invalid_fault_command_is_refused_with_the_expected_form(order: Order, says: str) -> None:
    with pytest.raises(InvalidInput, match=says):
        arguments(order, FAULTS)


def test_right_orders_give_their_arguments() -> None:
    assert arguments({"fault": "silence", "bus": "main", "id": 12}, FAULTS) == ("silence", {"id": 12})
    assert arguments({"fault": "delay", "seconds": 1}, FAULTS) == ("delay", {"seconds": 1})
    assert arguments({"fault": "clear"}, FAULTS) == ("clear", {})


@pytest.mark.parametrize(
    ("faults", "commands", "inside"),
    [
        (SerialBusFaults, FAULTS, {"rows", "require", "look", "speak"}),
        (CanFaults, CAN_FAULTS, {"rows", "require", "look", "strike", "next_command", "commands"}),
    ],
)
def test_every_fault_command_matches_a_fault_method_and_its_arguments(
    faults: type, commands: Mapping[str, Mapping[str, Any]], inside: set[str]
) -> None:
    methods = {
        name: inspect.signature(method).parameters
        for name, method in inspect.getmembers(faults, inspect.isfunction)
        if not name.startswith("_") and name not in inside
    }
    assert set(methods) == set(commands)
    for name, given in commands.items():
        taken = {key: value for key, value in methods[name].items() if key != "self"}
        assert [key.rstrip("?") for key in given] == list(taken)
        optional = {key for key, value in taken.items() if value.default is not inspect.Parameter.empty}
        assert {key[:-1] for key in given if key.endswith("?")} == optional


def test_the_page_shows_every_order_and_option_and_what_it_shows_is_right() -> None:
    page = (Path(__file__).parents[2] / "docs/virtual.md").read_text()
    shown = [json.loads(each) for each in re.findall(r'`(\{"fault".*?\})`', page)]
    assert {arguments(each, {**FAULTS, **BODY_FAULTS})[0] for each in shown} == {*FAULTS, *BODY_FAULTS}
    for option in re.findall(r"(?<![\w-])--?[a-z][a-z-]*", parser().format_help()):
        assert option in ("-h", "--help") or f"`{option}" in page, option


def served(path: Path, lines: bytes) -> list[Order]:
    def answer(order: Order) -> Order:
        if order.get("bus") == "other":
            raise KeyError("no bus other")
        return {"ok": True} | order

    orders = FaultCommandSocket(path, answer)
    try:
        assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(path))
            answers = b""
            for part in (lines[:5], lines[5:]):
                client.sendall(part)
                orders.serve()
                orders.serve()
            client.setblocking(False)
            answers = client.recv(65536)
        orders.serve()
        assert len(orders.filenos()) == 1, "a client that left is forgotten"
        return [json.loads(line) for line in answers.splitlines()]
    finally:
        orders.close()
        assert not path.exists()


def test_every_line_is_answered_also_the_bad_ones(tmp_path: Path) -> None:
    answers = served(tmp_path / "s", b'{"query": "state"}\nnonsense\n[1]\n{"bus": "other"}\n')
    assert answers[0] == {"ok": True, "query": "state"}
    assert [each["ok"] for each in answers[1:]] == [False] * 3
    assert '{"fault": "drop", "count": 3}' in answers[1]["error"], "what an order looks like"
    assert "object" in answers[2]["error"]
    assert answers[3]["error"] == "no bus other"


def test_a_dead_socket_is_replaced(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as old:
        old.bind(str(tmp_path / "s"))
    assert served(tmp_path / "s", b'{"query": "state"}\n')[0]["ok"]
