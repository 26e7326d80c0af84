"""Helpers shared by the computed and the real-time tests of doctor files."""

from collections.abc import Callable
from pathlib import Path

from tests.support.doctor_rig import plant


def spoil(path: Path, change: Callable[[str], str]) -> Path:
    before = path.read_text()
    after = change(before)
    assert after != before, "the file has nothing of that to spoil"
    path.write_text(after)
    return path


def settings(tmp_path: Path, robot: Path, **more: object) -> Path:
    lines = [f"robot: {robot}", f"state_dir: {tmp_path / 'state'}", f"sockets: {tmp_path / 'run'}"]
    lines += [f"{key}: {value}" for key, value in more.items()]
    return plant(tmp_path / "twind.yaml", "\n".join(lines) + "\n")
