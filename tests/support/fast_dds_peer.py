"""The peer by another vendor as a process: Fast DDS in C++, compiled when it is first asked for."""

import shutil
import struct
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "dds" / "fast_dds.cpp"
HEADERS = (Path("/usr/include/fastdds"), Path("/usr/include/fastcdr"))
_HEAD = struct.Struct("<QII")  # ns of arrival, topic, length


def built(folder: Path) -> Path:
    """The peer in C++, compiled. Skips the test where compiler or library are missing."""
    if shutil.which("g++") is None or not all(each.is_dir() for each in HEADERS):
        pytest.skip("needs g++, libfastrtps-dev and libfastcdr-dev: the peer by another vendor")
    program = folder / "fast_dds"
    command = ["g++", "-std=c++17", "-w", "-o", str(program), str(SOURCE), "-lfastrtps", "-lfastcdr"]
    subprocess.run(command, check=True, timeout=300.0)
    return program


class FastDds:
    """A listener that writes down what it hears, until it is ended."""

    def __init__(self, program: Path, domain: int, folder: Path, *topics: tuple[str, str, bool]) -> None:
        """`topics`: (topic, type, latched) as DDS calls them."""
        folder.mkdir()
        self._samples = folder / "samples"
        words = [word for name, kind, latched in topics for word in (name, kind, *(["latched"] * latched))]
        command = [str(program), str(domain), "listen", str(folder), *words]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._lines: list[str] = []
        late = threading.Timer(60.0, self.process.kill)
        late.start()
        try:
            while not self._lines or self._lines[-1] != "ready":
                assert self.process.stdout is not None
                line = self.process.stdout.readline()
                assert line, f"the peer ended: {self._lines}"
                self._lines.append(line.strip())
        finally:
            late.cancel()

    def received(self, topic: int = 0) -> list[tuple[int, bytes]]:
        """(ns of arrival, bytes) of each whole sample so far."""
        return [(time, data) for time, place, data in self._records() if place == topic]

    def end(self) -> list[str]:
        """All lines that it printed."""
        self._lines += self.process.communicate(timeout=30.0)[0].splitlines()
        return self._lines

    def kill(self) -> None:
        """At once; nothing where it has ended."""
        self.process.kill()
        self.process.wait(10.0)
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()

    def _records(self) -> Iterator[tuple[int, int, bytes]]:
        data = self._samples.read_bytes()
        at = 0
        while at + _HEAD.size <= len(data):
            time, topic, length = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            if at + length > len(data):
                return
            yield time, topic, data[at : at + length]
            at += length
