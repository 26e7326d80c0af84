"""Run end-to-end tests, and run those that failed once more, alone.

    python tools/second_run.py first FOLDER [PYTEST OPTIONS]    the tests of a folder
    python tools/second_run.py again FOLDER...                  those of them that failed, one at a time

Real processes share a machine with other tests, and with other users of the hardware. A test that fails
beside them and passes alone found a busy machine, not a defect. At most `MOST` tests of a folder may fail in
the first run: more are a failure at once. Both runs print what failed, so that a test that often needs its
second run is seen.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

MOST = 10
PASSED = 0
FAILED = 1  # pytest's exit code for failed tests; any other is no result of a test
CACHE = Path(".pytest_cache")


def failed_tests(cache: Path) -> list[str]:
    """Return the tests that failed in the last run with this cache folder."""
    record = cache / "v" / "cache" / "lastfailed"
    return sorted(json.loads(record.read_text())) if record.exists() else []


def pytest(cache: Path, *options: str) -> int:
    """Run pytest with a cache folder of its own; return its exit code."""
    command = [sys.executable, "-m", "pytest", "-m", "not campaign", "-o", f"cache_dir={cache}", *options]
    return subprocess.run(command, check=False).returncode


def run_first(folder: str, options: Sequence[str], cache_root: Path = CACHE) -> int:
    """Run the tests of a folder; return 0 where at most `MOST` failed, else the exit code."""
    cache = cache_root / Path(folder).name
    code = pytest(cache, "--cache-clear", *options, folder)
    failed = failed_tests(cache)
    if code != FAILED or not 0 < len(failed) <= MOST:
        return code
    print(f"{folder}: {len(failed)} failed and will run once more, alone:", *failed, sep="\n  ", flush=True)
    return PASSED


def run_again(folders: Sequence[str], cache_root: Path = CACHE) -> int:
    """Run the tests that failed in their first run, one at a time; return 0 where all passed."""
    worst = PASSED
    for folder in folders:
        cache = cache_root / Path(folder).name
        failed = failed_tests(cache)
        if failed:
            code = pytest(cache, *failed)
            print(f"{folder}: second run of {len(failed)} tests: exit code {code}", flush=True)
            worst = worst or code
    return worst


def main(arguments: Sequence[str]) -> int:
    """Run one of the two commands; return the exit code."""
    match arguments:
        case ["first", folder, *options]:
            return run_first(folder, options)
        case ["again", *folders] if folders:
            return run_again(folders)
    print(__doc__, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
