"""Log of a bridge: a blocked reader delays no caller, and a flood of lines is cut and counted."""

import threading

import pytest

from tests.support.processes import until
from twind.bridge.bridge_log import ROOM, BridgeLog, print_line


def test_a_blocked_reader_delays_no_caller_and_overflow_is_counted() -> None:
    lines: list[str] = []
    go_on = threading.Event()

    def slow(line: str) -> None:
        go_on.wait(20.0)
        lines.append(line)

    log = BridgeLog(slow)
    with log.writing():
        for number in range(10 * ROOM):
            log(str(number))
        go_on.set()
        until(lambda: len(lines) > 1, 10.0, "two lines")
        assert lines[0] == "0" and "came too fast" in lines[1]
    assert len(lines) > 2, "what waits is written at the end"


def test_a_text_of_several_lines_is_one_line_without_control_characters(
    capsys: pytest.CaptureFixture[str],
) -> None:
    print_line("POS_LIMIT: l_knee\nVEL_LIMIT: \x1b[2Jhead")
    assert capsys.readouterr().err == "twindctl: POS_LIMIT: l_knee; VEL_LIMIT: ?[2Jhead\n"
