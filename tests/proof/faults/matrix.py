"""The 42 rows, by number: what can go wrong, and how it is shown. A test walks 1 to 42."""

from __future__ import annotations

from dataclasses import replace

from tests.proof.faults import can_rows, holding_rows, line, outside, port, servos, timing
from tests.proof.faults.fault import Fault
from tests.proof.faults.real import REAL

ONLY_REAL = {
    33: Fault(
        33,
        "client that never reads",
        (),
        0.0,
        "tick goes on; telemetry is dropped and counted, the client hung up on",
        instead="virtual: the front's sockets are its own process's; its link is rows 27 and 40",
    ),
    37: Fault(
        37,
        "file edited while running",
        ("CALIB_MISMATCH", "CONFIG_CHANGED"),
        0.0,
        "arming refused",
        instead="virtual: the daemon under the fake clock was given its files, it has read none",
    ),
}
ROWS = {row.number: row for module in (port, line, servos, timing, outside) for row in module.ROWS} | {
    38: can_rows.ROW,
    41: holding_rows.ROW,
    42: holding_rows.PROTOCOL_ONE,
}
NO_REAL = {
    41: "real: the robot of the real runs has other servos; the bytes are those of virtual time",
    42: "real: as row 41",
    4: "real: other servos behind the port are other files to read; the bytes are those of virtual time",
    23: "real: the collector is off in the process that ticks; tests/loop/test_realtime.py holds it to that",
    30: "real: nobody may suspend this machine; a stopped process, row 25, is what it sees of it",
    39: "real: nothing that can be sent puts a number into the model that is none",
}
MATRIX: dict[int, Fault] = {
    number: replace(
        (ROWS | ONLY_REAL)[number],
        real=REAL.get(number),
        instead=(ROWS | ONLY_REAL)[number].instead or ("" if number in REAL else NO_REAL.get(number, "")),
    )
    for number in range(1, 43)
}
