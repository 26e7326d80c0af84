"""File systems of its own for a process: small ones in memory, in a mount namespace that a child keeps."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

_BLOCK = bytes(4096)
_FILLER = "filler"


@dataclass(frozen=True)
class OwnMounts:
    """A namespace with small file systems."""

    holder: int  # pid of the process that keeps it

    @property
    def enter(self) -> list[str]:
        """Command that becomes another one in there."""
        return ["nsenter", "-t", str(self.holder), "-U", "--preserve-credentials", "-m", "--"]

    def at(self, path: Path) -> Path:
        """A path in there, as it is reached from outside."""
        return Path(f"/proc/{self.holder}/root{path}")

    def fill(self, folder: Path) -> None:
        """Fill the file system of this folder to its last byte."""
        with (self.at(folder) / _FILLER).open("ab", buffering=0) as file:
            for block in (_BLOCK, b"x"):
                while _written(file.fileno(), block):
                    pass

    def empty(self, folder: Path) -> None:
        """Take out what `fill` put in."""
        (self.at(folder) / _FILLER).unlink()

    def remount(self, folder: Path, how: str) -> None:
        """Make a file system read-only (`ro`) or writable (`rw`)."""
        self.run("mount", "-o", f"remount,{how}", str(folder)).check_returncode()

    def run(self, *command: str) -> "subprocess.CompletedProcess[str]":
        """A command in there, run to its end."""
        return subprocess.run(
            [*self.enter, *command], capture_output=True, text=True, timeout=120, check=False
        )

    def twindctl(self, *words: str) -> "subprocess.CompletedProcess[str]":
        """A verb in there, run to its end."""
        return self.run(sys.executable, "-m", "twind.ctl.ctl_main", *words)


def _written(fd: int, data: bytes) -> bool:
    try:
        return os.write(fd, data) > 0
    except OSError:
        return False


@contextmanager
def own_mounts(sizes: Mapping[Path, str]) -> Iterator[OwnMounts]:
    """Small file systems in memory over these folders. Skips the test where the machine gives none."""
    missing = [each for each in ("unshare", "nsenter", "mount") if shutil.which(each) is None]
    if missing:
        pytest.skip(f"no {missing[0]} here: needs a mount namespace")
    mounts = "\n".join(f"mount -t tmpfs -o size={size},mode=1777 tmpfs '{at}'" for at, size in sizes.items())
    holder = subprocess.Popen(
        ["unshare", "-rm", "--propagation", "private", "sh", "-euc", f"{mounts}\necho made\nexec cat"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert holder.stdin is not None and holder.stdout is not None and holder.stderr is not None
    try:
        if holder.stdout.readline() != "made\n":
            pytest.skip(f"this machine gives no mount namespace: {holder.stderr.read().strip()}")
        yield OwnMounts(holder.pid)
    finally:
        holder.stdin.close()
        holder.wait(10)
        holder.stdout.close()
        holder.stderr.close()
