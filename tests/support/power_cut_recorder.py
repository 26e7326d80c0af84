"""A save recorded call by call, and every folder that a power cut after any of them can leave behind.

The disk is one that keeps no promise but those of POSIX: bytes are on it after `fsync` of their file, names
after `fsync` of their folder. Until then each of them may be there or not, whatever came later.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from twind import new_file

NAMING = ("create", "link", "rename", "unlink")
Folder = dict[str, bytes]  # what it holds, by name
Names = dict[str, int]  # name -> inode


@dataclass(frozen=True)
class Call:
    """One system call that changes the folder, or makes a change last."""

    what: str  # one of NAMING, truncate, write, sync, sync folder
    name: str = ""  # that it gives, or takes away
    inode: int = 0
    data: bytes = b""  # of a write
    source: str = ""  # of a rename: the name that goes


@dataclass
class SaveRecorder:
    """`os`, as far as a save uses it: does everything, and keeps a list of what changes the folder."""

    calls: list[Call] = field(default_factory=list)
    _inodes: dict[int, int] = field(default_factory=dict)  # descriptor -> inode; 0: the folder

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def open(self, path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        there = dir_fd is not None and path in os.listdir(dir_fd)
        fd = os.open(path, flags, mode, dir_fd=dir_fd)
        self._inodes[fd] = 0 if dir_fd is None else os.fstat(fd).st_ino
        if dir_fd is not None:
            self.calls.append(Call("truncate" if there else "create", path, self._inodes[fd]))
        return fd

    def write(self, fd: int, data: Any) -> int:
        count = os.write(fd, data)
        self.calls.append(Call("write", inode=self._inodes[fd], data=bytes(data[:count])))
        return count

    def fsync(self, fd: int) -> None:
        os.fsync(fd)
        inode = self._inodes[fd]
        self.calls.append(Call("sync", inode=inode) if inode else Call("sync folder"))

    def link(self, source: str, name: str, *, src_dir_fd: int, **where: Any) -> None:
        os.link(source, name, src_dir_fd=src_dir_fd, **where)
        self.calls.append(Call("link", name, os.stat(name, dir_fd=src_dir_fd).st_ino))

    def replace(self, source: str, name: str, *, src_dir_fd: int, **where: Any) -> None:
        inode = os.stat(source, dir_fd=src_dir_fd).st_ino
        os.replace(source, name, src_dir_fd=src_dir_fd, **where)
        self.calls.append(Call("rename", name, inode, source=source))

    def unlink(self, name: str, *, dir_fd: int) -> None:
        os.unlink(name, dir_fd=dir_fd)
        self.calls.append(Call("unlink", name))


@dataclass(frozen=True)
class Recording:
    """A folder before a save, and what the save did."""

    names: Names
    files: dict[int, bytes]
    calls: tuple[Call, ...]

    def aftermaths(self, count: int) -> Iterator[Folder]:
        """Every folder that a power cut after `count` of the calls can leave; each once."""
        seen = set()
        for held in self._left(self.calls[:count]):
            key = frozenset(held.items())
            if key not in seen:
                seen.add(key)
                yield held

    def _left(self, calls: tuple[Call, ...]) -> Iterator[Folder]:
        """Each unsynced name there or not, and of each unsynced file nothing, half or all of what is new."""
        lasting = dict(self.names)
        owed = list[Call]()
        content = dict(self.files)
        unsynced: set[int] = set()
        for call in calls:
            if call.what in NAMING:
                owed.append(call)
                if call.what == "create":
                    content[call.inode] = b""  # a number that was free is given again
            elif call.what == "sync folder":
                lasting = _named(lasting, owed)
                owed = []
            elif call.what == "sync":
                unsynced.discard(call.inode)
            else:
                unsynced.add(call.inode)
                content[call.inode] = (
                    b"" if call.what == "truncate" else content.get(call.inode, b"") + call.data
                )
        for made in product((False, True), repeat=len(owed)):
            names = _named(lasting, [call for call, there in zip(owed, made, strict=True) if there])
            for parts in product((0, 1, 2), repeat=len(unsynced)):
                kept = dict(content)
                for inode, part in zip(sorted(unsynced), parts, strict=True):
                    data = content.get(inode, b"")
                    kept[inode] = data[: len(data) * part // 2]
                yield {name: kept.get(inode, b"") for name, inode in names.items()}


def _named(names: Names, calls: list[Call]) -> Names:
    held = dict(names)
    for call in calls:
        held.pop(call.source if call.what == "rename" else call.name, None)
        if call.what != "unlink":
            held[call.name] = call.inode
    return held


def recorded(
    folder: Path, save: Callable[[], object], module: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> Recording:
    """Operations of `save` on `folder`; `module` is where it takes its `os` from, beside `new_file`."""
    paths = list(folder.iterdir())
    names = {path.name: path.stat().st_ino for path in paths}
    files = {path.stat().st_ino: path.read_bytes() for path in paths}
    recorder = SaveRecorder()
    with monkeypatch.context() as patch:
        patch.setattr(module, "os", recorder)
        patch.setattr(new_file, "os", recorder)
        save()
    return Recording(names, files, tuple(recorder.calls))


def laid_out(folder: Path, held: Folder) -> Path:
    """A fresh folder that holds that."""
    folder.mkdir()
    for name, data in held.items():
        (folder / name).write_bytes(data)
    return folder


def holding(folder: Path) -> Folder:
    """Content of a folder."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}
