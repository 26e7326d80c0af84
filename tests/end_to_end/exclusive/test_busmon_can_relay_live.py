"""The relay on a CAN leg: real pseudo-terminals, slcan text, the monitor as a process of its own."""

import os
import time
import tty
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.proof.busmon.started import Relayed, relayed
from tests.support.processes import Virtual
from twind.config.robot_file import load_robot

ROBOT = "h24-mixed"
QUESTION = b"t7FF8" + b"0100CC0000000000" + b"\r"  # Damiao 1: where are you?


@pytest.fixture(scope="module")
def virtual(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Virtual]:
    made = Virtual(tmp_path_factory.mktemp("leg"), ROBOT, "--muscles", "first-order")
    yield made
    made.close()


def send_texts(relay: Relayed, *texts: bytes) -> None:
    """A host that opens the port, says this, and listens a while."""
    fd = os.open(relay.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(fd)
    with suppress(OSError):  # caught already: it hangs up
        for text in texts:
            os.write(fd, text)
            time.sleep(0.05)
    end = time.monotonic() + 1.0
    while time.monotonic() < end and not relay.caught:
        time.sleep(0.02)
    os.close(fd)


def test_a_read_only_client_is_relayed_and_causes_no_violation(tmp_path: Path, virtual: Virtual) -> None:
    port = virtual.folder / "ports" / "l_leg"
    with relayed(tmp_path, port, load_robot(ROBOT).path, virtual.calibration, bus="l_leg") as relay:
        send_texts(relay, b"\r\rC\rS8\rO\r", *[QUESTION] * 5)
        assert relay.end() == 0, relay.printed()
        counts = relay.counts()
        assert counts["packets"] == 5
        assert counts["answers"] >= 5
        assert counts["violations"] == 0


@pytest.mark.parametrize(("text", "rule"), [
    (b"t0018FFFFFFFFFFFFFFFE\r", "W8"),  # a new zero
    (b"t0018FFFFFFFFFFFFFFFC\r", "W7"),  # torque, and its watchdog was not read back
    (b"t0018AABB\r", "W8"),
    (b"t7FF8010055150000484A\r", "W2"),  # another range
])  # fmt: skip
def test_a_wrong_line_ends_it_by_its_rule(tmp_path: Path, virtual: Virtual, text: bytes, rule: str) -> None:
    port = virtual.folder / "ports" / "l_leg"
    options = ("--hearsay", "0.1")
    given = (tmp_path, port, load_robot(ROBOT).path, virtual.calibration)
    with relayed(*given, bus="l_leg", options=options) as relay:
        relay.tell(told="mode", mode="live")
        send_texts(relay, b"C\rS8\rO\r", QUESTION, text, QUESTION)
        assert relay.end() == 1, relay.printed()
        assert f" {rule} " in relay.printed() or f" {rule}:" in relay.printed()
