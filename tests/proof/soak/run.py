"""`make soak`: hours of robot under the fake clock, or minutes of real processes.

`python -m tests.proof.soak.run --hours 24 --jobs 2 [--seed 0]` or `… --minutes 10 --real [--seed 0]`.
Each job is a robot of its own, with the next seed, and lives its share of the hours. Exit code 1: something
was wrong, or grew.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

OUT = Path(__file__).resolve().parents[3] / ".soak.json"


def _one(seed: int, hours: float, robot: str | None) -> dict[str, Any]:
    from tests.proof.soak.life import Life

    return {"seed": seed} | Life(seed, robot).live(hours)


def virtual(hours: float, jobs: int, seed: int, robot: str | None = None) -> list[dict[str, Any]]:
    """One result of each job."""
    share = hours / jobs
    if jobs == 1:
        return [_one(seed, share, robot)]
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        return list(pool.map(_one, range(seed, seed + jobs), [share] * jobs, [robot] * jobs))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--hours", type=float, default=0.1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", help="a robot of the lives; default: by the seed")
    parser.add_argument("--minutes", type=float, default=0.5)
    parser.add_argument("--real", action="store_true")
    options = parser.parse_args(arguments)
    begun = time.monotonic()
    if options.real:
        from tests.proof.soak.storm import storm

        found = [{"seed": options.seed} | storm(60.0 * options.minutes, options.seed)]
    else:
        found = virtual(options.hours, options.jobs, options.seed, options.robot)
    for each in found:
        print(json.dumps({key: value for key, value in each.items() if key != "wrong"}, indent=1))
        life = f"ROBOT={each.get('robot')} HOURS={each.get('hours', 0):g}"
        how = f"MINUTES={options.minutes:g} REAL=1" if options.real else life
        for wrong in each["wrong"]:
            print(f"make soak {how} SEED={each['seed']}: {wrong}")
    bad = sum(len(each["wrong"]) for each in found)
    OUT.write_text(json.dumps(found, indent=1))
    print(f"{bad} wrong, {time.monotonic() - begun:.0f} s; {OUT.name} has it")
    if not bad:
        print(f"passed: {options.minutes:g} min" if options.real else f"passed: {options.hours:g} h")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
