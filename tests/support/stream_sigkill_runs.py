"""A streamer whose endpoint is killed at random:
`python tests/support/stream_sigkill_runs.py SECONDS [SEED]`."""

import sys
import tempfile
from pathlib import Path

from tests.support.processes import simulated
from tests.support.stream_rig import killed_at_random


def main() -> int:
    seconds = float(sys.argv[1])
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    with tempfile.TemporaryDirectory() as name, simulated(Path(name) / "run") as daemon:
        kills, samples, told = killed_at_random(daemon.sockets, Path(name), seconds, seed, 4.0, 3.0)
    print(f"{kills} kills in {seconds:g} s: {samples} samples, each once; {told['failures']} failures")
    return 0


if __name__ == "__main__":
    sys.exit(main())
