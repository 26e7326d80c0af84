"""`make fuzz [N=…] [SEED=…] [WHAT=wire|frames|files|recordings] [FIRST=…]`: N inputs of each kind.

An input that breaks something is printed with the number that makes it again: `SEED=… FIRST=… N=1`.
"""

import argparse
import sys
import time
import traceback
from collections.abc import Callable
from random import Random

from tests.proof.fuzz import wire
from tests.proof.fuzz.files import Files
from tests.proof.fuzz.frames import Frames
from tests.proof.fuzz.recordings import Recordings

USUAL = {"wire": 20_000, "frames": 2_000, "files": 300, "recordings": 200}  # some seconds of each


def run(what: str, seed: int, first: int, count: int) -> int:
    """Inputs `first` .. `first + count` of a kind. Prints what it did; the number of failures (1 at most)."""
    begun = time.monotonic()
    number = first
    files = Files() if what == "files" else Recordings() if what == "recordings" else None
    frames = Frames() if what == "frames" else None
    one: Callable[[Random], object] = files.one if files else frames.one if frames else wire.one
    done = 0
    try:
        while done < count:
            done += int(one(Random(f"{what} {seed} {number}")) or 1)
            number += 1
        if frames:
            frames.finish()
    except BaseException:
        traceback.print_exc()
        again = f"make fuzz WHAT={what} SEED={seed} FIRST={number} N=1"
        print(f"{what}: input {number} of seed {seed} breaks it: {again}")
        return 1
    finally:
        for open_ in (files, frames):
            if open_:
                open_.close()
    summary = f", {files.accepted} accepted" if files else f", {frames.summary()}" if frames else ""
    print(f"{what}: {done} inputs of seed {seed} in {time.monotonic() - begun:.0f} s{summary}", flush=True)
    return 0


def main(arguments: list[str]) -> int:
    """Exit code 0: nothing broke."""
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__)
    parser.add_argument("-n", type=int, help="inputs of each kind; usual: " + str(USUAL))
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--what", choices=USUAL, action="append")
    asked = parser.parse_args(arguments)
    kinds = asked.what or list(USUAL)
    return sum(run(what, asked.seed, asked.first, asked.n or USUAL[what]) for what in kinds)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
