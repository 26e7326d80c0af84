"""`make faults`: every row again and again, a table of how soon each was told, and a fault-free hour.

`python -m tests.proof.faults.run [--number 100] [--real 3] [--rows 1,18] [--seed 7] [--hours 1]`.
`--seed` alone repeats one injection of `--rows`. Exit code 1: something was missed, late or wrong.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

from tests.proof.faults.fault import Fault, Outcome
from tests.proof.faults.matrix import MATRIX
from tests.proof.faults.world import once

OUT = Path(__file__).resolve().parents[3] / ".faults.json"
HEAD = ("row", "fault", "way", "injected", "detected", "median", "worst", "bound", "wrong", "again")


def virtual(row: Fault, seeds: range) -> list[Outcome]:
    """So many injections under the fake clock."""
    return [once(row, seed) for seed in seeds] if row.virtual is not None else []


def real(row: Fault, seeds: range) -> list[Outcome]:
    """So many over pseudo-terminals."""
    if row.real is None:
        return []
    from tests.proof.faults.ground import once_real

    return [once_real(row, seed) for seed in seeds]


def line(row: Fault, way: str, found: list[Outcome]) -> dict[str, Any]:
    """One line of the table. What has nothing to tell counts as detected where nothing was wrong."""
    delays = sorted(one.delay for one in found if one.delay is not None)
    bad = [one for one in found if one.wrong]
    missed = [one for one in bad if any("not told" in each or "neither told" in each for each in one.wrong)]
    return {
        "row": row.number,
        "fault": row.name,
        "way": way,
        "injected": len(found),
        "detected": len(found) - len(missed),
        "median": median(delays) if delays else None,
        "worst": delays[-1] if delays else None,
        "bound": max([one.bound for one in found if one.bound is not None], default=row.bound or None),
        "wrong": len(bad),
        "again": sum(one.again for one in found),
    }


def printed(row: dict[str, Any]) -> str:
    """Times in ms."""
    times = {
        key: "-" if row[key] is None else f"{row[key] * 1e3:.0f} ms" for key in ("median", "worst", "bound")
    }
    cells = [str(times.get(key, row[key])) for key in HEAD]
    widths = (3, 34, 8, 8, 8, 8, 8, 8, 5, 5)
    return " ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True))


def blame(row: Fault, way: str, found: list[Outcome], most: int) -> None:
    """Print each wrong outcome and the command that repeats it."""
    for one in [each for each in found if each.wrong][:most]:
        again = f"make faults ROW={row.number} SEED={one.seed}" + (" REAL=1" if way == "real" else "")
        print(f"    {again}")
        for each in one.wrong[:8]:
            print(f"        {each[:300]}")


def main(arguments: list[str] | None = None) -> int:
    """Everything, in order of the rows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--number", type=int, default=5, help="virtual injections of each row")
    parser.add_argument("--real", type=int, default=0, help="real-time injections of each row")
    parser.add_argument("--rows", default="", help="rows, by comma; default all")
    parser.add_argument("--seed", type=int, help="this injection alone, of each of the rows")
    parser.add_argument("--hours", type=float, default=0.0, help="fault-free hours besides")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    options = parser.parse_args(arguments)
    rows = [int(each) for each in options.rows.split(",") if each] or sorted(MATRIX)
    seeds = range(options.first, options.first + options.number)
    reals = range(options.first, options.first + options.real)
    if options.seed is not None:
        seeds = range(options.seed, options.seed + 1) if not options.real else range(0)
        reals = range(options.seed, options.seed + 1) if options.real else range(0)
    table: list[dict[str, Any]] = []
    wrong: list[dict[str, Any]] = []
    begun = time.monotonic()
    print(f"seeds {seeds.start}..{seeds.stop - 1} virtual, {reals.start}..{reals.stop - 1} real")
    print(" ".join(HEAD))
    for number in rows:
        row = MATRIX[number]
        for way, found in (("virtual", virtual(row, seeds)), ("real", real(row, reals))):
            if not found:
                continue
            table.append(line(row, way, found))
            print(printed(table[-1]), flush=True)
            blame(row, way, found, 3)
            wrong += [asdict(one) | {"way": way} for one in found if one.wrong]
        if row.instead:
            print(f"    {row.instead}")
    hours: dict[str, Any] = {}
    if options.hours:
        from tests.proof.faults.quiet import quiet

        hours = quiet(options.hours, options.seed or 0)
        print(f"fault-free: {hours}")
    OUT.write_text(json.dumps({"rows": table, "wrong": wrong, "fault_free": hours}, indent=1))
    bad = sum(row["wrong"] for row in table) + len(hours.get("wrong", []))
    total = sum(row["injected"] for row in table)
    print(f"{total} injections, {bad} wrong, {time.monotonic() - begun:.0f} s; {OUT.name} has them")
    print(f"next FIRST={max(seeds.stop, reals.stop)}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
