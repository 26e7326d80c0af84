"""`make fuzz [N=…] [SEED=…] [WHAT=KIND] [FIRST=…]`: N inputs of each kind.

An input that breaks something is printed with the number that makes it again: `SEED=… FIRST=… N=1`.
"""

import argparse
import sys
import time
import traceback
from collections.abc import Callable
from random import Random
from typing import NamedTuple

from tests.proof.fuzz.can import Can
from tests.proof.fuzz.checksum import Checksum
from tests.proof.fuzz.files import Files
from tests.proof.fuzz.frames import Frames
from tests.proof.fuzz.fuzz_target import FuzzTarget
from tests.proof.fuzz.recordings import Recordings
from tests.proof.fuzz.settings import Cards, Settings
from tests.proof.fuzz.wire import Wire


class FuzzKind(NamedTuple):
    """A kind of input."""

    target: Callable[[], FuzzTarget]
    usual: int  # inputs in some seconds


KINDS = {
    "wire": FuzzKind(Wire, 20_000),
    "checksum": FuzzKind(Checksum, 20_000),
    "can": FuzzKind(Can, 500_000),
    "frames": FuzzKind(Frames, 2_000),
    "files": FuzzKind(Files, 300),
    "settings": FuzzKind(Settings, 1_000),
    "cards": FuzzKind(Cards, 1_000),
    "recordings": FuzzKind(Recordings, 200),
}


def run(what: str, seed: int, first: int, count: int) -> int:
    """Inputs `first` .. `first + count` of a kind. Prints what it did; the number of failures (1 at most)."""
    begun = time.monotonic()
    number = first
    target = KINDS[what].target()
    done = 0
    broke = 0
    summary = ""
    try:
        while done < count:
            done += target.one(Random(f"{what} {seed} {number}")) or 1
            number += 1
        summary = target.finish()
    except (Exception, SystemExit):
        traceback.print_exc()
        again = f"make fuzz WHAT={what} SEED={seed} FIRST={number} N=1"
        print(f"{what}: input {number} of seed {seed} breaks it: {again}")
        broke = 1
        done += 1
        number += 1
    finally:
        target.close()
    print(f"{what}: {done} inputs of seed {seed} in {time.monotonic() - begun:.0f} s, {broke} broke", end="")
    print(f"{summary and f', {summary}'}, next FIRST={number}", flush=True)
    return broke


def main(arguments: list[str]) -> int:
    """Exit code 0: nothing broke."""
    usual = ", ".join(f"{name} {kind.usual}" for name, kind in KINDS.items())
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__)
    parser.add_argument("-n", type=int, help=f"inputs of each kind; usual: {usual}")
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--what", choices=KINDS, action="append")
    asked = parser.parse_args(arguments)
    kinds = asked.what or list(KINDS)
    return sum(run(what, asked.seed, asked.first, asked.n or KINDS[what].usual) for what in kinds)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
