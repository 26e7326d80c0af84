"""Robot and calibration files that nobody should write: a ConfigError that says where, in bounded time."""

import shutil
import tempfile
from pathlib import Path
from random import Random

from tests.proof.fuzz.fuzz_target import FuzzTarget
from tests.proof.fuzz.yaml_text import is_accepted, mutated_yaml
from tests.support.h24_calibration import ROBOT, TEXT, rehashed
from tests.support.small_robot_file import SMALL
from twind.config.calibration_file import read_calibration
from twind.config.robot_file import load_robot, read_robot


class Files(FuzzTarget):
    """Writes and reads mutated files in a folder of its own."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="twind-fuzz-"))
        shutil.copy(load_robot("h24").mjcf_path, self.folder / "arm.xml")
        self.accepted = 0

    def finish(self) -> str:
        """Number of accepted inputs."""
        return f"{self.accepted} accepted"

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder)

    def one(self, rng: Random) -> None:
        """One input. Raises whatever is wrong."""
        robot = rng.random() < 0.6
        data = mutated_yaml(rng, SMALL if robot else _short(rng))
        if not robot and rng.random() < 0.7:
            data = _resigned(data)
        self.accepted += is_accepted(lambda: self._read(data, robot=robot), len(data))

    def _read(self, data: bytes, *, robot: bool) -> None:
        if robot:
            path = self.folder / "arm-2.yaml"
            path.write_bytes(data)
            read_robot(path)
        else:
            read_calibration(data.decode("utf-8", "surrogateescape"), "fuzz", ROBOT)


def _short(rng: Random) -> str:
    """The calibration whole now and then (it is long), its first lines otherwise."""
    return TEXT if rng.random() < 0.2 else "\n".join(TEXT.split("\n")[:40])


def _resigned(data: bytes) -> bytes:
    """With a hash that fits, so that what stands behind it is read."""
    try:
        return rehashed(data.decode()).encode()
    except (UnicodeDecodeError, ValueError):
        return data
