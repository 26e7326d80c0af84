"""Ctrl-C in a program that does not handle it, and while one is imported, ends it with 130, no traceback."""

import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from twind import program_entries

ROOT = Path(__file__).parents[3]
WAITS = "print('here', flush=True)\nimport time\ntime.sleep(60)\n"
BEGUN = "def main():\n    print('here', flush=True)\n    import time\n    time.sleep(60)\n"


def started(folder: Path, text: str, *, before: str = "") -> subprocess.Popen[str]:
    """Start a program whose module has this text. Returns it once it printed its line."""
    (folder / "slow_program.py").write_text(text)
    code = f"{before}import sys; from twind.program_entries import start; sys.exit(start('slow_program'))"
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        [sys.executable, "-c", code], cwd=folder, stdout=pipe, stderr=pipe, text=True, env={"PYTHONPATH": "."}
    )
    assert process.stdout is not None and process.stdout.readline() == "here\n"
    return process


@pytest.mark.parametrize("text", [WAITS, BEGUN])
def test_ctrl_c_during_imports_and_in_the_program_ends_it_quietly(tmp_path: Path, text: str) -> None:
    process = started(tmp_path, text)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=30.0) == ("", "")
    assert process.returncode == program_entries.INTERRUPTED


def test_a_program_whose_interrupt_is_ignored_goes_on(tmp_path: Path) -> None:
    ignore = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); "
    text = (
        "import os, signal\nprint('here', flush=True)\nos.kill(os.getpid(), signal.SIGINT)\n"
        "def main(): return 3\n"
    )
    process = started(tmp_path, text, before=ignore)
    assert process.communicate(timeout=30.0) == ("", "")
    assert process.returncode == 3


def test_every_program_starts_there() -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert {value.partition(":")[0] for value in scripts.values()} == {program_entries.__name__}
    assert all(callable(getattr(program_entries, value.partition(":")[2])) for value in scripts.values())
