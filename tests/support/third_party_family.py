"""The example family of a third party (tests/drivers/lx16a_example), installed as a package of its own."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from twind.config.driver_family import family, registered

SOURCE = Path(__file__).parents[1] / "drivers" / "lx16a_example"
ROBOT = SOURCE / "lx16a-arm.yaml"


@contextmanager
def installed_family(folder: Path) -> Iterator[None]:
    """Install it into `folder`, where this process and those that it starts find it; gone afterwards."""
    source = shutil.copytree(SOURCE, folder / "source")  # a build leaves files beside the sources
    target = folder / "site"
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--no-index", "--target", target, source], check=True)
    before = set(sys.modules)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(target))
        patch.setenv("PYTHONPATH", str(target))
        _forget_families()
        try:
            yield
        finally:
            _forget_families()
            for name in set(sys.modules) - before:
                if name.startswith("twind_lx16a"):
                    del sys.modules[name]


def _forget_families() -> None:
    registered.cache_clear()
    family.cache_clear()
