"""`make coverage`: every line and branch of the mutated modules is run by the tests of its own room."""

import subprocess
import sys

from tests.proof.mutation.rooms import HOME, ROOMS


def main() -> int:
    """Exit code 0: nothing is left out."""
    modules = ",".join(module for room in ROOMS for module in room.modules)
    tests = [test for room in ROOMS for test in room.tests if (HOME / test).exists()]
    measured = [sys.executable, "-m", "coverage", "run", f"--include={modules}"]
    run = [*measured, "-m", "pytest", "-p", "tests.proof.mutation.calm", "--noconftest"]
    report = [sys.executable, "-m", "coverage", "report"]
    return subprocess.call([*run, *tests], cwd=HOME) or subprocess.call(report, cwd=HOME)


if __name__ == "__main__":
    sys.exit(main())
