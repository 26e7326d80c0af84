"""`python -m tests.proof.model N [--seed S]`: N random lives of the daemon under a fake clock, judged."""

import argparse
import random
import sys
import time

from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.proof.model.machine import Daemon


def main() -> int:
    """Run, and say what was run."""
    parser = argparse.ArgumentParser(prog="model", description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=100)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--seed", type=int, default=None, help="of an earlier run, to have it again")
    options = parser.parse_args()
    number = options.seed if options.seed is not None else random.randrange(1 << 32)
    print(f"seed {number}, {options.count} lives of up to {options.steps} steps", flush=True)
    began = time.monotonic()
    chosen = settings(
        max_examples=options.count,
        stateful_step_count=options.steps,
        deadline=None,
        database=None,
        print_blob=True,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
    run_state_machine_as_test(seed(number)(Daemon), settings=chosen)
    print(f"{options.count} lives, no invariant broken; {time.monotonic() - began:.0f} s")
    for what, times in sorted(Daemon.counted.items()):
        print(f"{times:7d} {what}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
