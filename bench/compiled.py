"""C programs of the benchmark, built with `cc` into a folder that the caller deletes."""

import os
import shutil
import subprocess
from pathlib import Path

from bench.harness import MeasurementUnavailable

SOURCES = Path(__file__).with_name("native")
OPTIONS = ("-O2", "-Wall", "-Wextra", "-Werror=implicit-function-declaration")


def compiled(name: str, folder: Path) -> Path:
    """Program `name`, built into `folder` unless it is there. Raises MeasurementUnavailable."""
    program = folder / name
    if program.exists():
        return program
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        raise MeasurementUnavailable("no C compiler (`cc`; Debian package gcc) for the servos in C")
    sources = sorted(map(str, SOURCES.glob(f"{name}*.c")))
    command = [compiler, *OPTIONS, "-o", str(program), *sources, "-lm"]
    built = subprocess.run(command, capture_output=True, text=True)
    if built.returncode:
        raise MeasurementUnavailable(f"{name}.c does not compile: {built.stderr.strip().splitlines()[:1]}")
    return program
