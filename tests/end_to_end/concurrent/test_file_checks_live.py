"""Real-time tests of doctor files."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.doctor_rig import ROOT, found
from tests.support.file_checks_rig import settings

HERE = Path(__file__).parents[3]
BUILT_IN = HERE / "twind/robots"
needs_root = pytest.mark.skipif(not ROOT, reason="looks as another user: needs root")


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A copy of h24 that a test may spoil."""
    folder = tmp_path / "robot"
    folder.mkdir()
    for suffix in ("yaml", "xml"):
        shutil.copy(BUILT_IN / f"h24.{suffix}", folder)
    return folder / "h24.yaml"


FULL = """
mount -t tmpfs -o size=3m none "$1/state" || exit 77
head -c 4m /dev/zero > "$1/state/recording" 2> /dev/null
"$2" -m twind.ctl.ctl_main --socket "$1" --json doctor --config "$1/twind.yaml" --only DISK_FULL
"""


@needs_root
def test_a_full_disk_is_found(tmp_path: Path, robot: Path) -> None:
    """On a disk of memory that only these processes see."""
    (tmp_path / "state").mkdir()
    settings(tmp_path, robot)
    if shutil.which("unshare") is None:
        pytest.skip("no unshare here")
    words = ["unshare", "--mount", "--propagation", "private", "sh", "-c", FULL, "sh", str(tmp_path)]
    done = subprocess.run([*words, sys.executable], capture_output=True, text=True, timeout=30, check=False)
    if done.returncode in (77, 1) and not done.stdout:
        pytest.skip(f"no mount namespace here: {done.stderr}")
    assert f'"thing": "{tmp_path / "state"}", "measured": "0 MiB free of 3"' in done.stdout
    assert str(tmp_path) not in str(found("--config", str(tmp_path / "twind.yaml"), code="DISK_FULL"))
