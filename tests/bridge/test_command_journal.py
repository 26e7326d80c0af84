"""Journal of commands: each result is written, and a blocked reader delays no command."""

import threading

from tests.support.processes import until
from twind.bridge.ros.command_journal import ROOM, CommandJournal, line


def test_a_line_has_what_whose_and_why() -> None:
    told = {"topic": "/cmd/joint_trajectory", "frame_id": "mine", "phase": "refused", "message": "NaN"}
    assert line(told) == "/cmd/joint_trajectory from 'mine': refused: NaN"
    assert line({"topic": "/cmd", "phase": "accepted", "id": "m1"}) == "/cmd: accepted m1"
    assert line({"topic": "/mode", "asked": "live", "phase": "done"}) == "/mode live: done"


def test_a_blocked_journal_reader_delays_no_caller_and_overflow_is_counted() -> None:
    lines: list[str] = []
    go_on = threading.Event()

    def slow(line: str) -> None:
        go_on.wait(20.0)
        lines.append(line)

    journal = CommandJournal(slow)
    journal.start()
    for number in range(10 * ROOM):
        journal.note({"topic": "/x", "phase": str(number)})
    go_on.set()
    until(lambda: len(lines) > 1, 10.0, "two lines")
    assert lines[0] == "/x: 0" and "came too fast" in lines[1]
    journal.close()
