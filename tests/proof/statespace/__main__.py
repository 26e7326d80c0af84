"""`python -m tests.proof.statespace [DEPTH] [--support S]`: every history of the loop's state machines."""

import argparse
import sys
import time

from tests.proof.statespace.search import explore
from tests.proof.statespace.world import CORE, STEPS, ModelWorld


def main() -> int:
    """Search, and print what was visited, or a shortest history that breaks a claim."""
    parser = argparse.ArgumentParser(prog="statespace", description=__doc__)
    parser.add_argument("depth", type=int, nargs="?", default=12)
    parser.add_argument("--support", default="gantry", choices=("fixed", "gantry", "free"))
    parser.add_argument("--core", action="store_true", help="arm, stops, reset, lost bus, deaths, lease only")
    options = parser.parse_args()
    begun = time.monotonic()
    steps = CORE if options.core else tuple(STEPS)
    result = explore(options.depth, steps, lambda: ModelWorld(options.support), progress=True)
    print(f"{result}; {time.monotonic() - begun:.0f} s; new states by depth {result.by_depth}")
    return 1 if result.broken else 0


if __name__ == "__main__":
    sys.exit(main())
