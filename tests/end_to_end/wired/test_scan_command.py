"""`twindctl scan --port`: a port that no daemon holds, looked at by real bytes on a pseudo-terminal."""

import argparse
import json
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.dynamixel_responder import PtyServos, Servos
from twind.ctl.ctl_main import main
from twind_calibration.scan import ids_of
from twind_drivers.ports.serial_port import SerialTransport

FEW = ("--baud", "1000000", "--ids", "0-9")  # a fifth of a second


@contextmanager
def port(*ids: int, change: Callable[[bytes], bytes] = lambda reply: reply) -> Iterator[PtyServos]:
    servos = Servos(ids)
    hear = servos.hear
    servos.hear = lambda data: change(hear(data))  # type: ignore[method-assign]
    with PtyServos(servos) as there:
        yield there


def test_every_device_on_a_free_port_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    with port(2, 7) as there:
        there.servos.put(7, 64, 1, 1)
        there.servos.put(7, 70, 0b100100, 1)
        assert main(["scan", "--port", there.path, *FEW]) == 0
    said = capsys.readouterr()
    assert said.out.splitlines() == [
        "1000000 baud  id   2  XM430-W350  firmware 45  torque off",
        "1000000 baud  id   7  XM430-W350  firmware 45  torque on  hardware error: overheating, overload",
    ]
    assert "ids 0 to 9 at 1 baud rate, about 0 s" in said.err
    assert "not searched: --kind feetech, dynamixel1" in said.err
    assert "\x1b" not in said.err  # no progress line where there is no terminal


def test_with_json_each_finding_is_a_line_and_nothing_else_is_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with port(2) as there:
        assert main(["scan", "--json", "--port", there.path, *FEW]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    (found,) = [json.loads(line) for line in said.out.splitlines()]
    assert found == {
        "kind": "dynamixel2",
        "baud": 1_000_000,
        "id": 2,
        "model": 1020,
        "model_name": "XM430-W350",
        "firmware": 45,
        "torque": False,
        "hardware_error": 0,
        "trouble": "",
    }


def test_several_rates_are_looked_at_one_after_the_other(capsys: pytest.CaptureFixture[str]) -> None:
    with port(2) as there:
        assert main(["scan", "--port", there.path, "--baud", "57600", "4500000", "--ids", "2"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["57600", "4500000"]


def test_a_device_with_a_fault_is_reported_and_the_scan_fails(capsys: pytest.CaptureFixture[str]) -> None:
    with port(3, change=lambda reply: reply * 2) as there:
        assert main(["scan", "--port", there.path, *FEW]) == 1
    assert "two devices answer as this id: disconnect one" in capsys.readouterr().out


def test_a_port_without_devices_fails_with_advice(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with port() as there:
        assert main(["scan", "--port", there.path, *FEW]) == 1
    said = capsys.readouterr().err
    assert "no device answers: is the power on" in said
    assert "Without --baud all rates are searched" in said


def test_a_port_in_use_is_refused_and_its_holder_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with port(2) as there:
        held = SerialTransport(there.path, 1_000_000)
        assert main(["scan", "--port", there.path, *FEW]) == 1
        assert there.servos.seen == []
        held.close()
        assert f"in use by pid {os.getpid()}" in capsys.readouterr().err
        assert main(["scan", "--port", there.path, *FEW]) == 0


def test_a_port_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scan", "--port", "/dev/tty-that-is-not"]) == 1
    assert "/dev/tty-that-is-not: no such port" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["main", "--port", "/dev/null"], ["--baud", "57600"], ["--ids", "1-3"], ["--thorough"]]
)
def test_an_incompatible_option_is_a_usage_error(words: list[str]) -> None:
    assert main(["scan", *words]) == 2


def test_on_a_terminal_each_step_is_shown_and_wiped(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    with port(2) as there:
        assert main(["scan", "--port", there.path, *FEW]) == 0
    said = capsys.readouterr().err
    assert "1000000 baud: searching" in said
    assert re.search(r"\rscan  ━+─* +\d+%  0:0\d  1000000 baud: reading id 2\x1b\[K", said)
    assert said.partition("not searched")[0].endswith("\r\x1b[K")


@given(st.integers(-5, 300), st.integers(-5, 300))
def test_ids_are_those_between_or_refused(first: int, last: int) -> None:
    if 0 <= first <= last <= 253:
        assert list(ids_of(f"{first}-{last}")) == list(range(first, last + 1))
        assert list(ids_of(str(first))) == [first]
    else:
        with pytest.raises(argparse.ArgumentTypeError, match="0 <= A <= B <= 253"):
            ids_of(f"{first}-{last}")


@pytest.mark.parametrize("text", ["", "-", "1-", "-3", "a", "1,2", "1-2-3", "٣", "3 "])
def test_other_words_are_no_ids(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError):
        ids_of(text)
